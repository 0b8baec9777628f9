"""The database's clock: the one that all who share it agree on."""

from __future__ import annotations

import time

from sqlalchemy import Connection, text

from lbacal_core.curves.validity import Instant


def read_database_clock(connection: Connection) -> Instant:
    """Now, in microseconds since 1970; with SQLite this machine's, where all who share the file run."""
    if connection.dialect.name == "sqlite":
        return time.time_ns() // 1000
    now = connection.execute(text("SELECT extract(epoch FROM clock_timestamp()) * 1000000"))
    return int(now.scalar_one())
