"""Input that nobody would send: documents and files that were right and then were changed at random."""

from __future__ import annotations

import copy
import io
import json
from typing import Any

import h5py
import numpy as np

NASTY: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63), 1e308, -1e308, 5e-324, -0.0, 0.5, "", " ", "\x00", "é", "X",
    "nan", "NaN", "1", "-1", "1e999", "../../x", "CS001", "a" * 300, "\ud800", "2014", "2014-01-01",
    "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", [], [[]], [None], [0], {}, {"": {}}, {"a": [1]},
)  # fmt: skip
FILTERS: tuple[dict[str, Any], ...] = ({}, {"compression": "gzip"}, {"compression": "lzf"}, {"fletcher32": True})


def change_json(rng: np.random.Generator, document: Any) -> Any:
    """A copy with one to three of its values replaced, removed, doubled or wrapped."""
    changed = copy.deepcopy(document)
    for _ in range(int(rng.integers(1, 4))):
        changed = _change_one(rng, changed)
    return changed


def _change_one(rng: np.random.Generator, value: Any) -> Any:
    inside = isinstance(value, dict | list) and len(value) > 0 and rng.random() < 0.9
    if not inside:
        nasty = copy.deepcopy(NASTY[int(rng.integers(len(NASTY)))])
        return [value] if rng.random() < 0.1 else nasty
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key = keys[int(rng.integers(len(keys)))]
    deed = rng.random()
    if deed < 0.1:
        del value[key]
    elif deed < 0.2 and isinstance(value, list):
        value.append(copy.deepcopy(value[key]))
    elif deed < 0.2:
        value[str(key) + "x"] = copy.deepcopy(value[key])
    else:
        value[key] = _change_one(rng, value[key])
    return value


def write_json(rng: np.random.Generator, document: Any) -> bytes:
    """A changed document as bytes, of which one in ten is not even JSON."""
    text = json.dumps(change_json(rng, document)).encode("utf-8", "surrogatepass")
    return change_bytes(rng, text) if rng.random() < 0.1 else text


def change_bytes(rng: np.random.Generator, content: bytes) -> bytes:
    """A copy that is cut, or has some bytes changed, removed or doubled."""
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 8))):
        if not changed:
            break
        k, deed = int(rng.integers(len(changed))), rng.random()
        if deed < 0.6:
            changed[k] = int(rng.integers(256))
        elif deed < 0.7:
            del changed[k : k + int(rng.integers(1, 30))]
        elif deed < 0.8:
            changed[k:k] = changed[k : k + int(rng.integers(1, 30))]
        elif deed < 0.9:
            changed[k : k + 8] = rng.bytes(8)
        else:
            del changed[k:]
    return bytes(changed)


def change_hdf5(rng: np.random.Generator, content: bytes) -> bytes:
    """A spectra file with bytes changed, or with a dataset replaced by one of another kind, shape or storage."""
    if rng.random() < 0.5:
        return change_bytes(rng, content)
    stream = io.BytesIO(content)
    with h5py.File(stream, "a") as file:
        names = [name for name in file if isinstance(file[name], h5py.Dataset)]
        name = names[int(rng.integers(len(names)))]
        data = file[name][()]
        del file[name]
        _replace(rng, file, name, data)
    return stream.getvalue()


def _replace(rng: np.random.Generator, file: h5py.File, name: str, data: Any) -> None:
    deed = int(rng.integers(9))
    if deed == 0:
        return
    if deed == 1:
        file[name] = h5py.SoftLink("/power")
    elif deed == 2:
        file[name] = h5py.ExternalLink("/etc/passwd", "/")
    elif deed == 3:
        file.create_group(name)
    elif deed == 4:
        file.create_dataset(name, shape=(2**40,), dtype="f8", chunks=(2**20,))
    elif deed == 5:
        file[name] = np.array(NASTY[int(rng.integers(3, 13))], dtype=float)
    elif deed == 6:
        kinds = ("f4", "f8", "i1", "i8", "u8", "S3", "c16", "bool", "O")
        kind = kinds[int(rng.integers(len(kinds)))]
        shape = tuple(int(n) for n in rng.integers(0, 5, int(rng.integers(0, 4))))
        file.create_dataset(name, shape=shape, dtype=h5py.string_dtype() if kind == "O" else kind)
    elif deed == 7 and np.ndim(data) > 0:
        filters = FILTERS[int(rng.integers(len(FILTERS)))]
        file.create_dataset(name, data=data[: int(rng.integers(0, len(data) + 1))], **filters, maxshape=None)
    else:
        flat = np.array(data).ravel()
        if flat.dtype.kind == "f" and flat.size:
            flat[int(rng.integers(flat.size))] = rng.choice([np.nan, np.inf, -1.0, 0.0, 1e308, 5e-324])
        file[name] = flat.reshape(np.shape(data))
