"""What never changes and is asked for again and again, kept in memory: what was asked for last stays longest."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Remembered(Generic[Key, Value]):
    """At most so many values by their keys. Threads share it; two that miss the same value both make it."""

    most: int
    _kept: OrderedDict[Key, Value] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def get_many(self, keys: Iterable[Key], make: Callable[[list[Key]], Mapping[Key, Value]]) -> dict[Key, Value]:
        """The values of some keys; those that are not here are made together, and left out where nothing makes them."""
        found: dict[Key, Value] = {}
        missing: list[Key] = []
        with self._lock:
            for key in dict.fromkeys(keys):
                if key in self._kept:
                    found[key] = self._kept[key]
                    self._kept.move_to_end(key)
                else:
                    missing.append(key)
        if missing:
            made = make(missing)
            found |= made
            with self._lock:
                self._kept.update(made)
                while len(self._kept) > self.most:
                    self._kept.popitem(last=False)
        return found
