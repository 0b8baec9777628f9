"""API keys: kept as hashes, expiring, revocable."""

from __future__ import annotations

import json
from dataclasses import dataclass

from sqlalchemy import delete, select, update

from lbacal_core.curves.validity import Instant
from service.errors import NotFoundError
from service.schema.tables import api_key, deed, session
from service.storage.rows import Store, equal, from_row, insert_into


@dataclass(frozen=True)
class Key:
    """An API key: its number, name, scopes and interval."""

    number: int
    name: str | None
    scopes: tuple[str, ...]
    created: Instant
    expires: Instant | None
    revoked: Instant | None

    @property
    def label(self) -> str:
        """How it is called wherever something says who did it."""
        return f"key {self.number}" + (f" ({self.name})" if self.name else "")

    def is_valid(self, now: Instant) -> bool:
        """Whether the key opens anything."""
        return self.revoked is None and (self.expires is None or now < self.expires)


class KeyStore(Store):
    """Keys by the SHA-256 of their text."""

    def add(
        self,
        sha256: str,
        scopes: tuple[str, ...],
        *,
        created: Instant,
        expires: Instant | None,
        name: str | None = None,
    ) -> int:
        """Keep a key and return its number."""
        texts = {"sha256": sha256, "name": name, "scopes": json.dumps(scopes)}
        row = {**texts, "created_us": created, "expires_us": expires}
        return int(self._connection.execute(api_key.insert().values(row).returning(api_key.c.id)).scalar_one())

    def find(self, sha256: str) -> Key | None:
        """The key with a hash, valid or not; None where there is none."""
        return next(iter(self.all(sha256)), None)

    def begin_session(self, sha256: str, key: int, expires: Instant, now: Instant) -> None:
        """Keep that a browser is logged in with a key, and forget the sessions that ran out."""
        self._connection.execute(delete(session).where(session.c.expires_us <= now))
        self._connection.execute(session.insert().values(sha256=sha256, key=key, expires_us=expires))

    def of_session(self, sha256: str, now: Instant) -> Key | None:
        """The key of a session that lasts, valid or not; None where none lasts."""
        of = select(api_key.c.sha256).join(session).where(session.c.sha256 == sha256, session.c.expires_us > now)
        found = self._connection.execute(of).scalar_one_or_none()
        return None if found is None else self.find(found)

    def end_session(self, sha256: str) -> None:
        """Forget a session."""
        self._connection.execute(delete(session).where(session.c.sha256 == sha256))

    def all(self, sha256: str | None = None) -> list[Key]:
        """List all keys, or that of a hash, oldest first."""
        statement = select(api_key).where(*equal(api_key, sha256=sha256)).order_by(api_key.c.id)
        return [
            from_row(Key, row, number=row.id, scopes=tuple(json.loads(row.scopes)))
            for row in self._connection.execute(statement)
        ]

    def revoke(self, number: int, now: Instant) -> None:
        """Close a key for good."""
        change = update(api_key).where(api_key.c.id == number, api_key.c.revoked_us.is_(None)).values(revoked_us=now)
        if self._connection.execute(change).rowcount == 0:
            raise NotFoundError(f"no key {number} that could be revoked; `lbacal keys list` shows them")


# Completed requests by idempotency key, so that a repeated request is not done again.

KEPT_US = 7 * 86_400_000_000


@dataclass(frozen=True)
class Deed:
    """The request under an idempotency key, and its answer."""

    request_sha256: str
    answer: str


class DeedStore(Store):
    """Completed requests by caller and idempotency key."""

    def begin(self, by: str, name: str, request_sha256: str, now: Instant) -> Deed | None:
        """Take a name (None), or get the request that has it, once that is done: who does it now is waited for."""
        self._connection.execute(delete(deed).where(deed.c.at_us < now - KEPT_US))
        row = {"by": by, "name": name, "request_sha256": request_sha256, "at_us": now}
        statement = insert_into(self._connection, deed).values(row).on_conflict_do_nothing().returning(deed.c.name)
        if self._connection.execute(statement).scalar_one_or_none() is not None:
            return None
        return self.find(by, name)

    def find(self, by: str, name: str) -> Deed | None:
        """The request under a name, once it is done; None until then."""
        statement = select(deed).where(deed.c.by == by, deed.c.name == name, deed.c.answer.is_not(None))
        found = self._connection.execute(statement).one_or_none()
        return None if found is None else from_row(Deed, found)

    def end(self, by: str, name: str, answer: str) -> None:
        """Keep what was answered."""
        change = update(deed).where(deed.c.by == by, deed.c.name == name).values(answer=answer)
        self._connection.execute(change)
