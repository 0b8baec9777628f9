"""Transactions on SQLite and PostgreSQL, and the stores that live inside one."""

from __future__ import annotations

import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url, text
from sqlalchemy.exc import DataError, DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from lbacal_core.errors import BadInputError, LbacalError
from service.errors import UnavailableError
from service.schema.tables import require_newest
from service.storage.alarms import AlarmStore
from service.storage.changes import ChangeStore
from service.storage.drift import DriftStore
from service.storage.jobs import JobStore
from service.storage.keys import DeedStore, KeyStore
from service.storage.ledger import LedgerStore, TagStore
from service.storage.models import InvestigationStore, ModelStore
from service.storage.processes import ProcessStore
from service.storage.spectra import SpectraStore
from service.storage.sums import SumStore
from service.storage.versions import BudgetStore, VersionStore

# What a failure beside this code means: the one place where errors of the databases become 503, and values 422.
#
# What is away, busy, full, read-only or of another schema is translated, and a value that no column holds (SQLSTATE
# class 22). A statement that is wrong stays an error of the program.

AWAY = "the database does not answer"
BUSY = "the database is busy"
FULL = "the disk of the database is full"
REVISION = text("SELECT version_num FROM alembic_version")
READ_ONLY = "the database takes no writes now"
NO_FILE = "there is no database there: correct LBACAL_DATABASE_URL, or run `lbacal db upgrade` to make one"
OTHER_SCHEMA = "the database schema is not the one this version needs: run `lbacal db upgrade`"

_OF_STATE = {"53100": FULL, "25006": READ_ONLY, "55P03": BUSY, "42P01": OTHER_SCHEMA, "42703": OTHER_SCHEMA}
_OF_CLASS = {
    "08": AWAY,
    "25": "the database ended a transaction that took too long",
    "40": BUSY,
    "53": "the database has no memory, disk or connections left",
    "57": "the database took too long, or is being stopped",
    "58": "the database cannot use its files",
}
"""SQLSTATE of PostgreSQL: whole, or its class (the first two characters)."""
_OF_SQLITE = {
    sqlite3.SQLITE_BUSY: BUSY,
    sqlite3.SQLITE_LOCKED: BUSY,
    sqlite3.SQLITE_PROTOCOL: BUSY,
    sqlite3.SQLITE_NOMEM: "the database has no memory left",
    sqlite3.SQLITE_READONLY: READ_ONLY,
    sqlite3.SQLITE_IOERR: "the database cannot use its files",
    sqlite3.SQLITE_FULL: FULL,
    sqlite3.SQLITE_CANTOPEN: "the database file cannot be opened",
    sqlite3.SQLITE_CORRUPT: "the database file is damaged: restore a backup",
    sqlite3.SQLITE_NOTADB: "the database file is not an SQLite database",
}
_PASSING = {AWAY, BUSY, FULL, _OF_CLASS["53"], _OF_CLASS["57"]}
_PRIMARY = 0xFF
"""The primary result code of SQLite stands in the low byte of the extended one."""


def explain_failure(error: SQLAlchemyError) -> LbacalError | None:
    """Explain a failure in one sentence; None if it is a fault of this program."""
    if isinstance(error, PoolTimeoutError):
        return UnavailableError(
            "the server is busy: no connection to the database is free", str(error), is_passing=True
        )
    if not isinstance(error, DBAPIError):
        return None
    if isinstance(error, DataError):
        return BadInputError("request", "values that the database can hold", str(error.orig))
    sentence: str | None
    sentence = _explain_sqlite(error.orig) if isinstance(error.orig, sqlite3.Error) else _explain_postgresql(error)
    if sentence is None:
        return None
    return UnavailableError(sentence, str(error.orig), is_passing=sentence in _PASSING)


def _explain_sqlite(error: sqlite3.Error) -> str | None:
    if "no such table" in str(error) or "no such column" in str(error) or "has no column" in str(error):
        return OTHER_SCHEMA
    return _OF_SQLITE.get(getattr(error, "sqlite_errorcode", 0) & _PRIMARY)


def _explain_postgresql(error: DBAPIError) -> str | None:
    state = getattr(error.orig, "sqlstate", None)
    if state is None:  # the client gave up before the server answered
        return AWAY if isinstance(error, OperationalError) or error.connection_invalidated else None
    return _OF_STATE.get(state) or _OF_CLASS.get(state[:2])


BUSY_S = 10
"""How long SQLite waits for another process that writes."""
POOL_S = 5
"""How long a use case waits for a connection."""
PATIENCE = {"statement_timeout": "60s", "lock_timeout": "5s", "idle_in_transaction_session_timeout": "60s"}
"""What PostgreSQL ends by itself, on every connection. A promotion is given less (see `LedgerStore.lock`)."""
ASKERS = 8
"""Connections for questions of a statement or two; such a question has its connection for about a millisecond."""

Answer = TypeVar("Answer")


class Stores:
    """The stores of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.spectra = SpectraStore(connection)
        self.budgets = BudgetStore(connection)
        self.versions = VersionStore(connection)
        self.sums = SumStore(connection)
        self.ledger = LedgerStore(connection)
        self.tags = TagStore(connection)
        self.investigations = InvestigationStore(connection)
        self.models = ModelStore(connection)
        self.jobs = JobStore(connection)
        self.processes = ProcessStore(connection)
        self.deeds = DeedStore(connection)
        self.drift = DriftStore(connection)
        self.changes = ChangeStore(connection)
        self.alarms = AlarmStore(connection)
        self.keys = KeyStore(connection)


class Database:
    """Opens transactions. One transaction a use case: it commits at the end of the block or leaves nothing.

    Those that only read have connections of their own, so that writers who wait for each other keep no reader waiting.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        parsed = make_url(url)
        self._file = _SqliteFile(parsed.database) if parsed.get_backend_name() == "sqlite" else None
        self.engine = _make_writing_engine(parsed)
        self._readers = _make_reading_engine(parsed)
        self._askers = _make_asking_engine(parsed)
        self._open = threading.local()
        self.write_failure: UnavailableError | None = None
        """Why the last transaction that wrote could not, where that will not pass by itself; None once one could."""

    @contextmanager
    def read(self) -> Iterator[Stores]:
        """A transaction that only reads; everything in it sees the database at one instant."""
        with self._transaction(self._readers) as connection:
            yield Stores(connection)

    def look(self, question: Callable[[Stores], Answer]) -> Answer:
        """The answer to a question that needs no more than what stores return; see `read`."""
        with self.read() as stores:
            return question(stores)

    def ask(self, question: Callable[[Stores], Answer]) -> Answer:
        """The answer to a question of a statement or two, which needs no transaction: a round trip each.

        Whether the connection is alive is not asked before: where it has died, the question is asked once more.
        """
        try:
            with self._transaction(self._askers) as connection:
                return question(Stores(connection))
        except UnavailableError as error:
            if not (isinstance(error.__cause__, DBAPIError) and error.__cause__.connection_invalidated):
                raise
        with self.read() as stores:
            return question(stores)

    @contextmanager
    def write(self) -> Iterator[Stores]:
        """A transaction that may write; on SQLite it holds the one write lock from its start.

        It writes into the schema of this code alone: an upgrade waits for it to end, and stops those that come after.
        Inside another one of the same use case it is a part of that: both commit at the end of the outer block.
        """
        outer: Stores | None = getattr(self._open, "stores", None)
        if outer is not None:
            yield outer
            return
        try:
            with self._transaction(self.engine) as connection:
                require_newest(connection.execute(REVISION).scalar())
                self._open.stores = Stores(connection)
                try:
                    yield self._open.stores
                    self._open.stores.ledger.require_prompt()
                finally:
                    self._open.stores = None
        except UnavailableError as error:
            if str(error) in (FULL, READ_ONLY):
                self.write_failure = error
            raise
        self.write_failure = None

    @contextmanager
    def _transaction(self, engine: Engine) -> Iterator[Connection]:
        if self._file:
            self._file.require_same()
        with explaining_failures(), engine.begin() as connection:
            yield connection

    def ping(self) -> None:
        """Ask whether the server of the database answers; a file has none."""
        if self._file is None:
            with self.connect() as connection:
                connection.execute(text("SELECT 1"))

    def make_file(self) -> None:
        """Make the file of an SQLite database where there is none: an upgrade may, and nothing else."""
        if self._file:
            self._file.make()

    @contextmanager
    def connect(self) -> Iterator[Connection]:
        """A connection that only reads, for those who look at the schema."""
        with self._transaction(self._readers) as connection:
            yield connection

    @property
    def free_bytes(self) -> int | None:
        """Room on the disk that holds an SQLite file; None where the database keeps its disk to itself."""
        return self._file.free_bytes if self._file else None

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()
        self._readers.dispose()
        self._askers.dispose()


@contextmanager
def explaining_failures() -> Iterator[None]:
    """Turn an error of a database that is away, busy or full into a failure with a sentence for the user."""
    try:
        yield
    except SQLAlchemyError as error:
        explained = explain_failure(error)
        if explained is None:
            raise
        raise explained from error


class _SqliteFile:
    """The file of an SQLite database: what is written into a removed file is lost, and SQLite reports no error."""

    def __init__(self, name: str | None) -> None:
        self._path = Path(name or "")
        self._number: int | None = None

    def make(self) -> None:
        """Make an empty file where there is none."""
        if not self._path.exists():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.touch()

    def require_same(self) -> None:
        """Refuse to begin without a file, and to go on when the file that was opened first is no longer there."""
        try:
            number = self._path.stat().st_ino
        except FileNotFoundError as error:
            if self._number is None:
                raise UnavailableError(NO_FILE, str(self._path.absolute())) from error
            number = None
        except OSError:
            if self._number is None:
                raise
            number = None
        if self._number is None:
            self._number = number
        elif number != self._number:
            raise UnavailableError(
                "the database file was removed or replaced while it was in use: restart the service",
                str(self._path.absolute()),
            )

    @property
    def free_bytes(self) -> int:
        """Room on its disk."""
        return shutil.disk_usage(self._path.absolute().parent).free


def _make_writing_engine(url: URL) -> Engine:
    if url.get_backend_name() == "sqlite":
        # one connection: those who write in this process wait in a fair queue, not in SQLite's
        return _prepare_sqlite(_make_sqlite_engine(url, pool_size=1, max_overflow=0), "BEGIN IMMEDIATE")
    return _make_postgresql_engine(url, pool_size=4, max_overflow=4)


def _make_reading_engine(url: URL) -> Engine:
    if url.get_backend_name() == "sqlite":
        return _prepare_sqlite(_make_sqlite_engine(url, pool_size=10, max_overflow=30), "BEGIN")
    engine = _make_postgresql_engine(url, pool_size=8, max_overflow=8)
    return engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)


def _make_asking_engine(url: URL) -> Engine:
    """Connections on which each statement is its own transaction."""
    if url.get_backend_name() == "sqlite":
        return _prepare_sqlite(_make_sqlite_engine(url, pool_size=ASKERS, max_overflow=0), None)
    given: dict[str, Any] = {"isolation_level": "AUTOCOMMIT", "pool_pre_ping": False}
    settings = PATIENCE | {"default_transaction_read_only": "on"}
    return _make_postgresql_engine(url, settings, pool_size=ASKERS, max_overflow=0, **given)


def _make_postgresql_engine(url: URL, settings: Mapping[str, str] = PATIENCE, **given: Any) -> Engine:
    options = " ".join(f"-c {name}={value}" for name, value in settings.items())
    arguments = {"connect_timeout": POOL_S, "options": options}
    return create_engine(url, connect_args=arguments, pool_timeout=POOL_S, **{"pool_pre_ping": True, **given})


def _make_sqlite_engine(url: URL, **pool: int) -> Engine:
    arguments = {"timeout": BUSY_S, "isolation_level": None, "check_same_thread": False}
    return create_engine(url, connect_args=arguments, pool_timeout=POOL_S, **pool)


def _prepare_sqlite(engine: Engine, begin: str | None) -> Engine:
    @event.listens_for(engine, "connect")
    def _prepare(connection: Any, _record: Any) -> None:
        cursor = connection.cursor()
        # FULL: a commit that was acknowledged survives a loss of power
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    if begin is not None:

        @event.listens_for(engine, "begin")
        def _begin(connection: Connection) -> None:
            # a deferred transaction that turns into a writing one fails at once when another writes; an immediate waits
            connection.exec_driver_sql(begin)

    return engine
