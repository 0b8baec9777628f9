"""Idempotent requests: one that is repeated because its answer was lost is answered again and not done again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from service.errors import ConflictError
from service.storage.database import Database
from service.storage.deeds import Deed

LONGEST_NAME = 200


@dataclass(frozen=True)
class Deeds:
    """Executes requests, once for each idempotency key."""

    database: Database
    clock: Callable[[], Instant]

    def once(self, by: str, name: str | None, request: bytes, do: Callable[[], bytes]) -> bytes:
        """Execute a request and return its answer, or the stored answer of the same idempotency key.

        Request and answer are one transaction: if the answer cannot be written, the request has no effect.

        Parameters
        ----------
        name
            The `Idempotency-Key` that the caller chose; None does the deed in any case.
        request
            What was asked, whole; something else under the same name is a conflict.
        """
        if name is None:
            with self.database.write():
                return do()
        _require_printable(name)
        with self.database.write() as stores:
            earlier = stores.deeds.begin(by, name, _digest(request), self.clock())
            if earlier is not None:
                return _answer_of(earlier, name, request)
            answer = do()
            stores.deeds.end(by, name, answer.decode())
            return answer

    def recall(self, by: str, name: str | None, request: bytes) -> bytes | None:
        """The stored answer of an idempotency key, for requests that take long to work out; None if there is none."""
        if name is None:
            return None
        _require_printable(name)
        with self.database.read() as stores:
            earlier = stores.deeds.find(by, name)
        return None if earlier is None else _answer_of(earlier, name, request)


def _require_printable(name: str) -> None:
    if not (0 < len(name) <= LONGEST_NAME and name.isprintable()):
        raise BadInputError("Idempotency-Key", f"1 to {LONGEST_NAME} printable characters", repr(name[:60]))


def _digest(request: bytes) -> str:
    return hashlib.sha256(request).hexdigest()


def _answer_of(earlier: Deed, name: str, request: bytes) -> bytes:
    if earlier.request_sha256 != _digest(request):
        raise ConflictError(f"something else was asked under the Idempotency-Key {name!r}")
    return earlier.answer.encode()
