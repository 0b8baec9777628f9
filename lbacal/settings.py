"""Names of the settings, `LBACAL_*` in the environment: one that nobody reads is refused, for somebody meant it.

The server's settings have their types and defaults in `service.config`; a client knows only what they are called.
"""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path

from lbacal_core.errors import BadInputError

PREFIX = "LBACAL_"
CLIENT_SETTINGS = {
    "LBACAL_DASK": ("address of a dask scheduler for traces, investigations and workers, or local", "none"),
    "LBACAL_URL": ("address of the server, for the client", "http://127.0.0.1:8000"),
    "LBACAL_API_KEY": ("key of the client; reads need none unless the server says so", "none"),
    "LBACAL_CACHE": ("folder of the client for synced tags, which answer while no server does", "none"),
    "LBACAL_TEST_PG": ("PostgreSQL server for the tests, as postgresql://user@host/name", "server binaries found here"),
}
"""What the client, extras and the tests read: meaning and default."""
SERVER_SETTINGS = (
    "LBACAL_DATABASE_URL", "LBACAL_INSTRUMENT", "LBACAL_SKY_POWER", "LBACAL_CAUSES",
    "LBACAL_RESISTANCE_OHM",
    "LBACAL_MAX_BODY_MB", "LBACAL_MAX_OPEN_PARTS", "LBACAL_MAX_WINDOW_DAYS", "LBACAL_MAX_CONNECTIONS",
    "LBACAL_MAX_RATE", "LBACAL_OPEN_READS", "LBACAL_WAIT_S", "LBACAL_LEASE_S", "LBACAL_POLL_S", "LBACAL_NIGHTLY_UTC",
    "LBACAL_QUIET_S", "LBACAL_CUT_WINDOWS", "LBACAL_NIGHTLY_INVESTIGATIONS", "LBACAL_STALE_DAYS",
    "LBACAL_GATE_CHANGE", "LBACAL_GATE_ERROR", "LBACAL_GATE_COVERAGE", "LBACAL_GATE_BAND", "LBACAL_LOG_LEVEL",
)  # fmt: skip


def causes_file() -> Path | None:
    """The file of the causes that this installation has beside the catalogue; None where it has none."""
    named = os.environ.get("LBACAL_CAUSES")
    return Path(named) if named else None


def require_known_settings() -> None:
    """Refuse a setting of the environment that nobody reads."""
    known = [name.removeprefix(PREFIX) for name in (*SERVER_SETTINGS, *CLIENT_SETTINGS)]
    for name in sorted(name.removeprefix(PREFIX) for name in os.environ if name.startswith(PREFIX)):
        if name not in known:
            near = get_close_matches(name, known, 1)
            expected = f"a name such as {PREFIX}{near[0]}" if near else "a name in docs/settings.md"
            raise BadInputError(f"{PREFIX}{name}", expected, "this one")
