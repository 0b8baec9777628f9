"""Settings: environment variables `LBACAL_*`, each with its unit and default (docs/settings.md)."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from pydantic import Field, ValidationError, field_validator
from pydantic_core import PydanticCustomError
from pydantic_settings import BaseSettings, SettingsConfigDict

from lbacal.settings import PREFIX, require_known_settings
from lbacal_core.errors import BadInputError
from service.errors import describe_refusal

_TIME_OF_DAY = "^([01][0-9]|2[0-3]):[0-5][0-9]$"
_LEVEL = "^(debug|info|warning|error)$"


class Settings(BaseSettings):
    """Everything that differs from one installation to the next."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, frozen=True, extra="ignore", allow_inf_nan=False)

    database_url: str = Field(default="./var/lbacal.sqlite", description="SQLite file, or postgresql://user@host/name")
    instrument: str = Field(default="lofar-superterp", description="name of a shipped instrument, or a file")
    sky_power: Path | None = Field(default=None, description="sky power file; none = the package's own sky")
    causes: Path | None = Field(default=None, description="file of causes beside the catalogue (lbacal causes add)")
    resistance_ohm: float = Field(default=50.0, gt=0, description="R_r of all spectra, Ohm; it cancels in C")
    max_body_mb: float = Field(default=64, gt=0, description="largest request body, MB")
    max_open_parts: int = Field(default=50, gt=0, description="parts of jobs that one key may have waiting")
    max_window_days: float = Field(default=732, gt=0, description="longest window of a refit, days")
    max_connections: int = Field(default=500, gt=0, description="connections of clients at once; more are closed")
    max_rate: float = Field(
        default=500, gt=0, description="requests a second of one address; ten seconds' worth at once"
    )
    open_reads: bool = Field(default=True, description="reads need no key")
    wait_s: float = Field(default=60, ge=0, description="how long a process that starts waits for the database, s")
    lease_s: float = Field(default=120, gt=0, description="a worker silent for this long has lost its part, s")
    poll_s: float = Field(default=1, gt=0, description="pause of an idle worker between two looks for work, s")
    nightly_utc: str = Field(default="02:00", pattern=_TIME_OF_DAY, description="when due refits are found, UTC")
    quiet_s: float = Field(
        default=600, ge=0, description="the scheduler waits until no spectra arrived for so long, six times at most, s"
    )
    cut_windows: bool = Field(
        default=True, description="cut the windows of an antenna at dates at which the drift found that it changed"
    )
    nightly_investigations: bool = Field(
        default=True, description="whether the daily run also looks for what the simulation gets wrong"
    )
    stale_days: float = Field(
        default=30, ge=0, description="age of the newest event from which on data count as stale, days; 0 = never"
    )
    gate_change: float = Field(default=0.1, gt=0, description="largest change of mean C that passes, fraction")
    gate_error: float = Field(
        default=0.05, gt=0, description="largest mean error of C in the good channels that passes, fraction"
    )
    gate_coverage: float = Field(
        default=0.4, ge=0, le=1, description="smallest share of the sidereal day with events that passes"
    )
    gate_band: float = Field(default=0.7, ge=0, le=1, description="smallest share of good channels that passes")
    log_level: str = Field(default="info", pattern=_LEVEL, description="debug, info, warning or error")

    @field_validator("database_url")
    @classmethod
    def _require_known_database(cls, url: str) -> str:
        scheme, is_url, _ = url.partition("://")
        if not url or (is_url and scheme not in ("sqlite", "postgresql", "postgresql+psycopg", "postgres")):
            raise PydanticCustomError("database", "a file, or postgresql://user@host/name")
        if is_url and scheme != "sqlite":
            parts = urlsplit(url)
            try:
                _ = parts.port
            except ValueError:
                raise PydanticCustomError("database", "a number as port in postgresql://user@host:port/name") from None
        return url

    @property
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


def read_settings() -> Settings:
    """The settings of the environment, or one sentence about the first that is wrong."""
    require_known_settings()
    try:
        return Settings()
    except ValidationError as error:
        errors = error.errors(include_url=False)
        name = PREFIX + "_".join(str(part) for part in errors[0]["loc"]).upper()
        expected, found = describe_refusal(errors)
        if errors[0]["type"] == "database":  # which may hold a password
            found = f"{found.partition('://')[0]}://...'" if "://" in found else found
        raise BadInputError(name, expected, found) from error
