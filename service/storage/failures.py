"""What a failure beside this code means: the one place where errors of the databases become 503, and values 422.

What is away, busy, full, read-only or of another schema is translated, and a value that no column holds (SQLSTATE class
22). A statement that is wrong stays an error of the program.
"""

from __future__ import annotations

import sqlite3

from sqlalchemy.exc import DataError, DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from lbacal_core.errors import BadInputError, LbacalError
from service.errors import UnavailableError

AWAY = "the database does not answer"
BUSY = "the database is busy"
FULL = "the disk of the database is full"
READ_ONLY = "the database takes no writes now"
OTHER_SCHEMA = "the database schema is not the one this version needs: run `lbacal db upgrade`"

_OF_STATE = {
    "53100": FULL,
    "25006": READ_ONLY,
    "55P03": BUSY,
    "42P01": OTHER_SCHEMA,
    "42703": OTHER_SCHEMA,
}
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
    """What to tell about a failure; None if it is a fault of this program."""
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
