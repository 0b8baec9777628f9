"""Transactions on SQLite and PostgreSQL, and the stores that live inside one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, make_url, text
from sqlalchemy.exc import DBAPIError, OperationalError

from service.errors import UnavailableError
from service.storage.drift import DriftStore
from service.storage.jobs import JobStore
from service.storage.keys import KeyStore
from service.storage.ledger import LedgerStore
from service.storage.spectra import SpectraStore
from service.storage.versions import VersionStore

BUSY_S = 30


class Stores:
    """The stores of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    @cached_property
    def spectra(self) -> SpectraStore:
        """Events and their spectra."""
        return SpectraStore(self._connection)

    @cached_property
    def versions(self) -> VersionStore:
        """Calibration versions."""
        return VersionStore(self._connection)

    @cached_property
    def ledger(self) -> LedgerStore:
        """Promotions."""
        return LedgerStore(self._connection)

    @cached_property
    def jobs(self) -> JobStore:
        """Refits asked for and due."""
        return JobStore(self._connection)

    @cached_property
    def drift(self) -> DriftStore:
        """Monthly ratios of C."""
        return DriftStore(self._connection)

    @cached_property
    def keys(self) -> KeyStore:
        """API keys."""
        return KeyStore(self._connection)


class Database:
    """Opens transactions. One transaction a use case: it commits at the end of the block or leaves nothing."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.engine = _make_engine(url)

    @contextmanager
    def read(self) -> Iterator[Stores]:
        """A transaction that only reads."""
        with self._transaction(is_writing=False) as connection:
            yield Stores(connection)

    @contextmanager
    def write(self) -> Iterator[Stores]:
        """A transaction that may write; on SQLite it holds the one write lock from its start."""
        with self._transaction(is_writing=True) as connection:
            yield Stores(connection)

    @contextmanager
    def _transaction(self, *, is_writing: bool) -> Iterator[Connection]:
        try:
            with self.engine.execution_options(lbacal_writing=is_writing).begin() as connection:
                yield connection
        except OperationalError as error:
            raise UnavailableError(f"the database does not answer: {error.orig}") from error
        except DBAPIError as error:
            if error.connection_invalidated:
                raise UnavailableError(f"the connection to the database was lost: {error.orig}") from error
            raise

    def ping(self) -> None:
        """Ask the database for one number."""
        with self._transaction(is_writing=False) as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()


def _make_engine(url: str) -> Engine:
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        return create_engine(url, pool_size=10, max_overflow=10, pool_pre_ping=True)
    if parsed.database:
        Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(url, connect_args={"timeout": BUSY_S, "isolation_level": None, "check_same_thread": False})

    @event.listens_for(engine, "connect")
    def _prepare(connection: Any, _record: Any) -> None:
        cursor = connection.cursor()
        # FULL: a commit that was acknowledged survives a loss of power
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        # a deferred transaction that turns into a writing one fails at once when another writes; an immediate one waits
        is_writing = connection.get_execution_options().get("lbacal_writing", True)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if is_writing else "BEGIN")

    return engine
