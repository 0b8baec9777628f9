"""Tags: a name for what the ledger said at an instant, which nobody can change any more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from service.errors import ConflictError, NotFoundError
from service.storage.database import Database
from service.storage.tags import Tag
from service.wire.bodies import TagBody
from service.wire.instants import format_instant, parse_instant

SETTLED_US = 60_000_000
"""The ledger at an instant is final once this time has passed: promotions commit within 5 s of their `at`."""


@dataclass(frozen=True)
class Knowledge:
    """As of when the ledger is read: None is now. `text` is how an answer states it.

    `is_final`: no promotion can be made any more that this reading of the ledger would see.
    """

    as_of: Instant | None
    text: str | None
    is_final: bool


@dataclass(frozen=True)
class Tags:
    """Makes tags and reads them."""

    database: Database
    clock: Callable[[], Instant]

    def put(self, name: str, body: TagBody, by: str) -> tuple[Tag, bool]:
        """Freeze the ledger under a name, as it is now or was at `as_of`; the tag, and whether it is new."""
        wanted = None if body.as_of is None else self._past(body.as_of)
        with self.database.write() as stores:
            stores.ledger.lock()
            earlier = stores.tags.find(name)
            if earlier is not None:
                if earlier.reason != body.reason or wanted not in (None, earlier.as_of):
                    found = f"{format_instant(earlier.as_of)}, {earlier.reason!r}"
                    raise ConflictError(f"the tag {name} exists with another content: {found}; choose another name")
                return earlier, False
            now = self.clock()
            newest = stores.ledger.require_clocks(now)
            as_of = max(now, newest) if wanted is None else wanted
            tag = Tag(name, as_of, by, body.reason, now)
            stores.tags.add(tag)
            return tag, True

    def after(self, cursor: str, limit: int) -> Sequence[Tag]:
        """Tags in order of their names, after a cursor."""
        with self.database.read() as stores:
            return stores.tags.after(cursor, limit)

    def read_knowledge(self, as_of: str | None, tag: str | None) -> Knowledge:
        """What a question means by `as_of` or `tag`."""
        if tag is None:
            instant = None if as_of is None else self._past(as_of)
            return Knowledge(instant, as_of, instant is not None and instant < self.clock() - SETTLED_US)
        if as_of is not None:
            raise BadInputError("tag", "either tag or as_of", "both")
        with self.database.read() as stores:
            found = stores.tags.find(tag)
        if found is None:
            raise NotFoundError(f"no tag {tag!r}; GET /v1/tags lists them")
        return Knowledge(found.as_of, format_instant(found.as_of), is_final=True)

    def _past(self, text: str) -> Instant:
        instant = parse_instant("as_of", text)
        if instant > self.clock():
            raise BadInputError("as_of", "an instant not later than now", format_instant(instant))
        return instant
