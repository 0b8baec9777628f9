"""Where a number came from: hashes of its inputs and the versions that made it."""

from __future__ import annotations

import hashlib
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from importlib.metadata import version
from typing import Any, Generic, TypeVar

import numpy as np

MODEL_VERSION = 19
"""Raised by hand, with a decision record, when the same inputs give other numbers in a served calibration."""
DRIFT_VERSION = 8
"""The same for what is found to change in the same events: stored reports are made anew."""


def canonical_json(content: object) -> str:
    """Write content as the one JSON text that is hashed: keys sorted, no spaces, no NaN."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def as_json(value: Any) -> Any:
    """A value as JSON values: what its `as_dict` says, else its fields by name; arrays as lists, null for no number."""
    if hasattr(value, "as_dict"):
        return value.as_dict()
    if isinstance(value, np.ndarray):
        return np.where(np.isfinite(value), value, np.array(None)).tolist()
    if is_dataclass(value):
        return {one.name: as_json(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {name: as_json(one) for name, one in value.items()}
    return [as_json(one) for one in value] if isinstance(value, tuple | list) else value


def with_arrays(content: Mapping[str, Any]) -> dict[str, Any]:
    """JSON values with every list, which must hold numbers, as an array; null is NaN."""
    return {name: np.array(one, dtype=float) if isinstance(one, list) else one for name, one in content.items()}


def hash_content(content: object) -> str:
    """SHA-256 (hex) of the canonical JSON of `content`."""
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def hash_arrays(*arrays: Any) -> str:
    """SHA-256 (hex) of arrays by dtype, shape and little-endian bytes; strings hash as UTF-8."""
    digest = hashlib.sha256()
    for array in arrays:
        values = np.asarray(array)
        if values.dtype.kind in "UO":
            digest.update(canonical_json([str(value) for value in values.ravel()]).encode())
        else:
            values = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
            digest.update(f"{values.dtype.str}{values.shape}".encode())
            digest.update(values.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


@dataclass(frozen=True)
class Provenance:
    """The inputs of a result by name and hash, the settings used and the versions of what made it.

    `notes` states by the name of an input what was done to it on the way.
    """

    inputs: Mapping[str, str]
    settings: Mapping[str, Any] = field(default_factory=dict)
    model_version: int = MODEL_VERSION
    notes: Mapping[str, str] = field(default_factory=dict)

    def with_note(self, name: str, note: str) -> Provenance:
        """Add a note to the provenance."""
        return replace(self, notes={**self.notes, name: note})

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON values, the version of the package as `lbacal`."""
        return {
            "inputs": dict(self.inputs),
            "settings": dict(self.settings),
            "model_version": self.model_version,
            "lbacal": version("lbacal"),
            **({"notes": dict(self.notes)} if self.notes else {}),
        }


# What never changes and is asked for again and again, kept in memory: what was asked for last stays longest.

Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Remembered(Generic[Key, Value]):
    """At most so many values by their keys. Threads share it; two that miss the same value both make it."""

    most: int
    _kept: OrderedDict[Key, Value] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        return Remembered, (self.most,)  # what is remembered stays in its process

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

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key, made where it is not here."""
        return self.get_many([key], lambda _: {key: make()})[key]
