"""Tags: names under which the ledger is frozen at an instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, select

from lbacal_core.curves.validity import Instant
from service.schema.tables import tag


@dataclass(frozen=True)
class Tag:
    """A name for the ledger as it was known at `as_of`; who gave it, when and why."""

    name: str
    as_of: Instant
    by: str
    reason: str
    at: Instant


class TagStore:
    """Tags are made once and never changed."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def find(self, name: str) -> Tag | None:
        """A tag by its name."""
        row = self._connection.execute(select(tag).where(tag.c.name == name)).one_or_none()
        return None if row is None else _value(row)

    def add(self, new: Tag) -> None:
        """Write a tag; under the lock of the ledger."""
        row = {"name": new.name, "as_of_us": new.as_of, "by": new.by, "reason": new.reason, "at_us": new.at}
        self._connection.execute(tag.insert().values(row))

    def after(self, cursor: str, limit: int) -> Sequence[Tag]:
        """Tags in order of their names, after a cursor."""
        statement = select(tag).where(tag.c.name > cursor).order_by(tag.c.name).limit(limit)
        return [_value(row) for row in self._connection.execute(statement)]


def _value(row: Row[Any]) -> Tag:
    return Tag(row.name, row.as_of_us, row.by, row.reason, row.at_us)
