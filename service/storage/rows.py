"""Rows in and out: written once or in place of what was, the same way on SQLite and PostgreSQL, and read as values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Connection, Row, Select, Table
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.validity import Scope
from service.errors import NotFoundError

Value = TypeVar("Value")
Rows = Sequence[Mapping[str, Any]]
MANY_KEYS = 500


class Store:
    """Rows of some tables inside one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection


def insert_into(connection: Connection, table: Table) -> Any:
    """An INSERT that may say what happens on a conflict."""
    return sqlite_insert(table) if connection.dialect.name == "sqlite" else postgresql_insert(table)


def add_rows(connection: Connection, table: Table, rows: Rows) -> None:
    """Insert rows; one whose key is there stays as it is."""
    if rows:
        connection.execute(insert_into(connection, table).on_conflict_do_nothing(), rows)


def put_rows(connection: Connection, table: Table, rows: Rows) -> None:
    """Insert rows in place of those of the same primary key."""
    if rows:
        statement, keys = insert_into(connection, table), [column.name for column in table.primary_key]
        changed = {name: statement.excluded[name] for name in rows[0] if name not in keys}
        connection.execute(statement.on_conflict_do_update(index_elements=keys, set_=changed), rows)


def select_many(
    connection: Connection, statement: Select[Any], column: ColumnElement[Any], keys: Iterable[Any]
) -> Iterator[Row[Any]]:
    """The rows of a statement in which a column has one of some keys, asked `MANY_KEYS` at a time in their order."""
    wanted = sorted(set(keys))
    for start in range(0, len(wanted), MANY_KEYS):
        yield from connection.execute(statement.where(column.in_(wanted[start : start + MANY_KEYS])))


def require_one(found: Iterable[Value], lacking: str) -> Value:
    """The first of what was found; `NotFoundError` with a sentence where nothing was."""
    for one in found:
        return one
    raise NotFoundError(lacking)


def to_row(value: Any, table: Table, **given: Any) -> dict[str, Any]:
    """The fields of a value by the names of columns, an instant `made` under `made_us`; `given` are other columns."""
    of_value = {column.name: column.name.removesuffix("_us") for column in table.columns if column.name not in given}
    return {**{name: getattr(value, one) for name, one in of_value.items() if hasattr(value, one)}, **given}


def equal(table: Table, **wanted: Any) -> list[ColumnElement[bool]]:
    """Conditions on columns by their names; None asks nothing of a column."""
    return [table.c[name] == value for name, value in wanted.items() if value is not None]


def scope_columns(scope: Scope) -> dict[str, Any]:
    """The columns `scope` (its key), `station`, `antenna` and `dipole` of a scope; None where it names none."""
    return {"scope": scope.key, "station": scope.station, "antenna": scope.antenna, "dipole": scope.dipole}


def from_row(cls: type[Value], row: Row[Any], **given: Any) -> Value:
    """The value whose fields a row holds; `given` are those that it holds in another form."""
    names = [one.name for one in fields(cls) if one.name not in given]  # type: ignore[arg-type] # all are dataclasses
    return cls(**{name: getattr(row, f"{name}_us" if hasattr(row, f"{name}_us") else name) for name in names}, **given)
