"""Completed requests by idempotency key, so that a repeated request is not done again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, delete, select, update
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.validity import Instant
from service.schema.tables import deed

KEPT_US = 7 * 86_400_000_000


@dataclass(frozen=True)
class Deed:
    """The request under an idempotency key, and its answer."""

    request_sha256: str
    answer: str


class DeedStore:
    """Completed requests by caller and idempotency key."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def begin(self, by: str, name: str, request_sha256: str, now: Instant) -> Deed | None:
        """Take a name; the deed that has it already, once that is done: somebody who does it now is waited for."""
        self._connection.execute(delete(deed).where(deed.c.at_us < now - KEPT_US))
        row = {"by": by, "name": name, "request_sha256": request_sha256, "at_us": now}
        statement = self._insert(deed).values(row).on_conflict_do_nothing().returning(deed.c.name)
        if self._connection.execute(statement).scalar_one_or_none() is not None:
            return None
        return self.find(by, name)

    def find(self, by: str, name: str) -> Deed | None:
        """The deed under a name, once it is done."""
        statement = select(deed).where(deed.c.by == by, deed.c.name == name, deed.c.answer.is_not(None))
        found = self._connection.execute(statement).one_or_none()
        return None if found is None else Deed(found.request_sha256, found.answer)

    def end(self, by: str, name: str, answer: str) -> None:
        """Keep what was answered."""
        change = update(deed).where(deed.c.by == by, deed.c.name == name).values(answer=answer)
        self._connection.execute(change)
