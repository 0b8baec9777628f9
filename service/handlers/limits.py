"""How much one caller may ask for: buckets that fill with time, one for each address."""

from __future__ import annotations

import hashlib
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from service.errors import TooManyError

MOST_REMEMBERED = 10_000
BAD_KEYS_AT_ONCE = 10
BAD_KEYS_PER_S = 1 / 6
"""An address may try ten wrong keys, and then ten a minute."""


@dataclass
class Buckets:
    """One bucket a name: it holds `size` tokens and gains `rate` a second; what is done takes one."""

    rate: float
    size: float
    clock: Callable[[], float] = time.monotonic
    _filled: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def take(self, name: str, *, spends: bool = True) -> float:
        """Take a token and return 0; where there is none, return the seconds until there is one.

        Without `spends` the bucket is only looked into.
        """
        with self._lock:
            now = self.clock()
            level, since = self._filled.pop(name, (self.size, now))
            level = min(self.size, level + self.rate * (now - since))
            is_enough = level >= 1.0
            self._filled[name] = (level - 1.0 if is_enough and spends else level, now)
            if len(self._filled) > MOST_REMEMBERED:
                self._filled.popitem(last=False)  # asked least recently
            return 0.0 if is_enough else (1.0 - level) / self.rate


class KeyGuard:
    """Slows down whoever tries keys. A key that was good here before is let through, whoever else tries from there."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._refused = Buckets(BAD_KEYS_PER_S, BAD_KEYS_AT_ONCE, clock)
        self._good: OrderedDict[bytes, None] = OrderedDict()
        self._lock = threading.Lock()

    def require_patience(self, address: str, authorization: str | None) -> None:
        """Refuse to look at another unknown key of an address that tried too many."""
        if authorization is None or _hash(authorization) in self._good:
            return
        wait = self._refused.take(address, spends=False)
        if wait > 0:
            raise TooManyError("too many wrong keys came from this address", wait)

    def note_good(self, authorization: str | None) -> None:
        """Remember a key that was accepted."""
        if authorization is not None:
            with self._lock:
                self._good[_hash(authorization)] = None
                if len(self._good) > MOST_REMEMBERED:
                    self._good.popitem(last=False)

    def note_refused(self, address: str, authorization: str | None) -> None:
        """Count a key that was not accepted, whether it is good no more or never was."""
        if authorization is not None:
            self._refused.take(address)
            with self._lock:
                self._good.pop(_hash(authorization), None)


def _hash(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()
