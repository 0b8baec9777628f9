"""API keys: made once, shown once, kept as a hash."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from lbacal.instants import DAY_US
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from service.errors import ForbiddenError, UnauthenticatedError
from service.storage.database import Database
from service.storage.keys import Key

SCOPES = ("read", "spectra:write", "refits:run", "calibrations:promote", "admin")
LONGEST_NAME = 60
SESSION_US = DAY_US // 2
"""A browser is logged in for as long as it is open, and no longer than this."""


@dataclass(frozen=True)
class Caller:
    """The caller of a request: a key, or nobody in particular."""

    name: str
    scopes: frozenset[str]

    def may(self, scope: str) -> bool:
        """Whether a scope was granted; `admin` holds all."""
        return scope in self.scopes or "admin" in self.scopes


@dataclass(frozen=True)
class Keys:
    """Makes keys and checks them."""

    database: Database
    clock: Callable[[], Instant]
    open_reads: bool = True

    def create(self, scopes: tuple[str, ...], days: float | None = None, name: str | None = None) -> tuple[int, str]:
        """Make a key, which ends after `days` or never: its number and its text, which exists only in this answer."""
        unknown = [scope for scope in scopes if scope not in SCOPES]
        if unknown or not scopes:
            raise BadInputError("scope", f"one or more of {', '.join(SCOPES)}", unknown[0] if unknown else "none")
        if days is not None and not 0 < days < 36_525:
            raise BadInputError("expires", "days > 0", f"{days:g}")
        if name is not None and not (0 < len(name) <= LONGEST_NAME and name.isprintable() and name.strip()):
            raise BadInputError("name", f"1 to {LONGEST_NAME} printable characters", repr(name[: LONGEST_NAME + 1]))
        text = "lbacal_" + secrets.token_urlsafe(32)
        now = self.clock()
        expires = None if days is None else now + round(days * DAY_US)
        with self.database.write() as stores:
            return stores.keys.add(_sha256(text), scopes, created=now, expires=expires, name=name), text

    def revoke(self, number: int) -> None:
        """Close a key for good."""
        with self.database.write() as stores:
            stores.keys.revoke(number, self.clock())

    def begin_session(self, text: str) -> str:
        """Exchange the text of a key for that of a session, which ends by itself, or with the key."""
        key, session, now = self._find(text), secrets.token_urlsafe(32), self.clock()
        with self.database.write() as stores:
            stores.keys.begin_session(_sha256(session), key.number, now + SESSION_US, now)
        return session

    def end_session(self, session: str) -> None:
        """Forget a session."""
        with self.database.write() as stores:
            stores.keys.end_session(_sha256(session))

    def require(self, authorization: str | None, *scopes: str, session: str | None = None) -> Caller:
        """Find the caller, if they may: `authorization` is the header, `session` a browser's; None where absent."""
        caller = self._identify(authorization) if session is None else self._recognise(session)
        for scope in scopes:
            if not caller.may(scope):
                if authorization is None and session is None:
                    raise UnauthenticatedError(f"this needs a key with scope {scope}: Authorization: Bearer KEY")
                raise ForbiddenError(f"{caller.name} has no scope {scope}, only {', '.join(sorted(caller.scopes))}")
        return caller

    def _identify(self, authorization: str | None) -> Caller:
        if authorization is None:
            return Caller("anyone", frozenset({"read"} if self.open_reads else ()))
        scheme, _, text = authorization.partition(" ")
        if scheme.lower() != "bearer":
            raise UnauthenticatedError("the header Authorization is not of the form: Bearer KEY")
        return _caller_of(self._find(text.strip()))

    def _find(self, text: str) -> Key:
        key = self.database.ask(lambda stores: stores.keys.find(_sha256(text)))
        if key is None or not key.is_valid(self.clock()):
            raise UnauthenticatedError("the key is unknown, expired or revoked")
        return key

    def _recognise(self, session: str) -> Caller:
        key = self.database.ask(lambda stores: stores.keys.of_session(_sha256(session), self.clock()))
        if key is None or not key.is_valid(self.clock()):
            raise UnauthenticatedError("the session has ended, or its key is expired or revoked: log in again")
        return _caller_of(key)


def _caller_of(key: Key) -> Caller:
    return Caller(key.label, frozenset(key.scopes) | {"read"})


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
