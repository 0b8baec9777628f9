"""Which processes of the service live: each writes now and then that it does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, delete, select, text

from lbacal_core.curves.validity import Instant
from service.schema.tables import process
from service.storage.rows import Store, from_row, insert_into

# The database's clock: the one that all who share it agree on.


def read_database_clock(connection: Connection) -> Instant:
    """Now, in microseconds since 1970; with SQLite this machine's, where all who share the file run."""
    if connection.dialect.name == "sqlite":
        return time.time_ns() // 1000
    now = connection.execute(text("SELECT extract(epoch FROM clock_timestamp()) * 1000000"))
    return int(now.scalar_one())


API, SCHEDULER, WORKER = "api", "scheduler", "worker"
ALIVE_US = 60_000_000
"""Who has been silent for a minute counts as dead."""
FORGOTTEN_US = 86_400_000_000


@dataclass(frozen=True)
class Process:
    """A process of the service; `silent_us` is how long ago it said that it lives."""

    name: str
    kind: str
    started: Instant
    silent_us: int
    inputs: str | None

    @property
    def is_alive(self) -> bool:
        """Whether it spoke within the last minute."""
        return self.silent_us < ALIVE_US


class ProcessStore(Store):
    """Processes by their names, seen by the clock of the database."""

    def see(self, name: str, kind: str, inputs: str | None) -> None:
        """Note that a process (`api`, `scheduler`, `worker`) lives, and forget those that died a day ago."""
        now = read_database_clock(self._connection)
        row = {"name": name, "kind": kind, "started_us": now, "seen_us": now, "inputs": inputs}
        statement = insert_into(self._connection, process).values(row)
        seen = {"seen_us": statement.excluded.seen_us, "inputs": statement.excluded.inputs}
        self._connection.execute(statement.on_conflict_do_update(index_elements=["name"], set_=seen))
        self._connection.execute(delete(process).where(process.c.seen_us < now - FORGOTTEN_US))

    def leave(self, name: str) -> None:
        """Note that a process has ended as it should."""
        self._connection.execute(delete(process).where(process.c.name == name))

    def all(self) -> Sequence[Process]:
        """Processes that reported within a day, by kind and name."""
        now = read_database_clock(self._connection)
        rows = self._connection.execute(select(process).order_by(process.c.kind, process.c.name))
        return [from_row(Process, row, silent_us=now - row.seen_us) for row in rows]
