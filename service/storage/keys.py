"""API keys: kept as hashes, expiring, revocable."""

from __future__ import annotations

import json
from dataclasses import dataclass

from sqlalchemy import Connection, select, update

from lbacal_core.curves.validity import Instant
from service.errors import NotFoundError
from service.schema.tables import api_key


@dataclass(frozen=True)
class Key:
    """Who may do what, until when."""

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


class KeyStore:
    """Keys by the SHA-256 of their text."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

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
        """The key with a hash, valid or not."""
        rows = self._keys(sha256)
        return rows[0] if rows else None

    def all(self) -> list[Key]:
        """All keys, oldest first."""
        return self._keys(None)

    def revoke(self, number: int, now: Instant) -> None:
        """Close a key for good."""
        change = update(api_key).where(api_key.c.id == number, api_key.c.revoked_us.is_(None)).values(revoked_us=now)
        if self._connection.execute(change).rowcount == 0:
            raise NotFoundError(f"no key {number} that could be revoked; `lbacal keys list` shows them")

    def _keys(self, sha256: str | None) -> list[Key]:
        statement = select(api_key).order_by(api_key.c.id)
        if sha256 is not None:
            statement = statement.where(api_key.c.sha256 == sha256)
        return [
            Key(row.id, row.name, tuple(json.loads(row.scopes)), row.created_us, row.expires_us, row.revoked_us)
            for row in self._connection.execute(statement)
        ]
