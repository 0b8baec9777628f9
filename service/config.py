"""Settings: environment variables `LBACAL_*`, each with its unit and default (docs/settings.md)."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Everything that differs from one installation to the next."""

    model_config = SettingsConfigDict(env_prefix="LBACAL_", frozen=True, extra="ignore")

    database_url: str = Field("./var/lbacal.sqlite", description="SQLite file, or postgresql://user@host/name")
    instrument: str = Field("lofar-superterp", description="name of a shipped instrument, or an instrument file")
    sky_power: Path | None = Field(None, description="sky power file; none = the package's own sky")
    resistance_ohm: float = Field(50.0, gt=0, description="R_r of all spectra, Ohm: one constant, it cancels in C")
    max_body_mb: float = Field(64, gt=0, description="largest request body, MB")
    open_reads: bool = Field(True, description="reads need no key")
    lease_s: float = Field(120, gt=0, description="a worker silent for this long has lost its part, s")
    poll_s: float = Field(1, gt=0, description="pause of an idle worker between two looks for work, s")
    nightly_utc: str = Field("02:00", pattern=r"^[0-2][0-9]:[0-5][0-9]$", description="when due refits are found, UTC")
    gate_change: float = Field(0.1, gt=0, description="largest change of the mean C that passes the gate, fraction")
    gate_error: float = Field(0.05, gt=0, description="largest mean statistical error that passes the gate, fraction")
    log_level: str = Field("info", pattern="^(debug|info|warning|error)$", description="least level written")

    @cached_property
    def sqlalchemy_url(self) -> str:
        """The database as SQLAlchemy names it."""
        url = self.database_url
        for scheme in ("postgresql://", "postgres://"):
            if url.startswith(scheme):
                return "postgresql+psycopg://" + url.removeprefix(scheme)
        return url if "://" in url else f"sqlite:///{url}"

    @property
    def is_sqlite(self) -> bool:
        """Whether the embedded database is used."""
        return self.sqlalchemy_url.startswith("sqlite")
