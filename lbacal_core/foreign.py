"""Values of JSON files and arrays of NumPy archives from strangers: each is checked, and refused in one sentence."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError, reading, require_parts
from lbacal_core.grids import Floats

# Values of JSON files, each checked, with one clear sentence where one is not what it should be.


def read_text(path: Path, expected: str = "text") -> str:
    """Read a text file, with one clear sentence when it is not one; `expected` is what the text should be."""
    broken = reading(f"{path}: expected {expected}, found something else", UnicodeDecodeError)
    with broken, reading(f"{path}: cannot be read", OSError):
        return path.read_text(encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read a JSON file, with one clear sentence when it is not one."""
    text = read_text(path, "JSON")
    if not text.strip():
        raise UnreadableFileError(f"{path}: expected JSON, found an empty file")
    with reading(f"{path}: expected JSON, found something else", ValueError, RecursionError):
        return json.loads(text, object_pairs_hook=require_unique_fields)


def require_unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, refused when it gives a field twice: one of the two would be lost."""
    content = dict(pairs)
    if len(content) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the field {twice!r} twice in one object")
    return content


def parse_numbers(values: Any, place: str) -> Floats:
    """Make an array, shape (entry,), of a JSON list of finite numbers, naming the first entry that is none."""
    if not isinstance(values, list):
        raise BadInputError(place, "a list of numbers", type(values).__name__)
    return np.array([parse_number(value, f"{place}, entry {k}") for k, value in enumerate(values)], dtype=float)


def parse_number(value: Any, place: str) -> float:
    """Read a finite number."""
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer of more than 308 digits
        pass
    raise BadInputError(place, "a finite number", repr(value))


def parse_cell(text: str | None, place: str) -> float:
    """Read a finite number of a table of texts; NaN for an empty cell."""
    if text is None or not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInputError(place, "a finite number, or an empty cell where there is none", text.strip()[:40])
    return value


def parse_instant(text: Any, place: str) -> float:
    """Seconds since 1970 of an ISO 8601 date or instant, UTC unless it says otherwise."""
    try:
        instant = datetime.fromisoformat(text)
        return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).astimezone(UTC).timestamp()
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInputError(place, "an ISO 8601 date or instant", repr(text)) from error


def parse_name(value: Any, place: str) -> str:
    """Read a printable name."""
    if not isinstance(value, str) or not value or not value.isprintable():
        raise BadInputError(place, "a name", repr(value))
    return value


def write_instant(at_unix: float) -> str:
    """An instant, s UTC, to the second as ISO 8601."""
    return f"{datetime.fromtimestamp(at_unix, UTC):%Y-%m-%dT%H:%M:%SZ}"


def parse_optional_name(value: Any, place: str) -> str | None:
    """Read a printable name, or None where there is none."""
    return None if value is None else parse_name(value, place)


# NumPy `.npz` files from strangers: named arrays, or one sentence on why not.

_FAILURES = (OSError, ValueError, EOFError, KeyError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
"""What NumPy and zipfile raise on broken files."""


def read_npz(path: Path, wanted: tuple[str, ...], words: str) -> dict[str, NDArray[Any]]:
    """Read every array of an .npz file by name, which must hold the `wanted` ones.

    Parameters
    ----------
    words
        What the file should hold, for the message: ``Jones terms``.
    """
    # Opened here, because np.load leaves a broken file open.
    with (
        reading(f"{path}: expected a NumPy .npz file of {words}, found a broken one", *_FAILURES),
        path.open("rb") as file,
    ):
        arrays = np.load(file, allow_pickle=False)
        content = {key: arrays[key] for key in arrays.files} if isinstance(arrays, np.lib.npyio.NpzFile) else {}
    require_parts(str(path), "arrays", wanted, content)
    return content
