"""HDF5 files from strangers: one dataset at a time, its storage, type and size settled before its data are read.

The HDF5 library can be made to read other files (links, external and virtual storage), to run filters, or to fill
memory with data that were never written. What is refused here is refused before that happens. What the library does
with a file that is broken on purpose (it may crash or never return) only another process can contain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError

HDF5_FAILURES = (OSError, RuntimeError, ValueError, TypeError, KeyError, AttributeError, MemoryError, OverflowError)
"""What h5py raises on broken files; our own refusals are none of these."""

_LARGEST_DEFLATION = 1100
"""gzip makes data at most 1032 times smaller: a dataset that claims more was never written."""


@dataclass(frozen=True)
class Kind:
    """A type of data sets: its name in words, a test of a dtype, and the type into which it is read."""

    words: str
    admits: Callable[[np.dtype[Any]], bool]
    read_as: type


FLOATS = Kind("8-byte floats", lambda dtype: dtype.kind == "f" and dtype.itemsize == 8, np.float64)
REALS = Kind("floats of 4 or 8 bytes", lambda dtype: dtype.kind == "f" and dtype.itemsize in (4, 8), np.float64)
INTEGERS = Kind("integers", lambda dtype: dtype.kind in "iu", np.int64)
NUMBERS = Kind("numbers", lambda dtype: dtype.kind in "fiu", np.float64)
STRINGS = Kind("strings", lambda dtype: h5py.check_string_dtype(dtype) is not None, np.str_)


def is_in_file(parent: h5py.Group, name: str) -> bool:
    """Whether a name leads to something in this very file, not along a link elsewhere."""
    return isinstance(parent.get(name, getlink=True), h5py.HardLink)


def open_dataset(file: h5py.File, name: str, kind: Kind, here: str) -> h5py.Dataset:
    """Open a dataset of a kind, refusing whatever could make the library read elsewhere or run a filter.

    Parameters
    ----------
    here
        The file and the dataset in words, for the message.
    """
    if not is_in_file(file, name):
        found = "none" if file.get(name, getlink=True) is None else "a link"
        raise BadInputError(here, "a dataset in this file", found)
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise BadInputError(here, "a dataset", f"a {type(dataset).__name__.lower()}")
    if dataset.external or dataset.is_virtual:
        raise BadInputError(here, "a dataset stored in this file", "external or virtual storage")
    filters = dataset.id.get_create_plist()
    codes = [filters.get_filter(k)[0] for k in range(filters.get_nfilters())]
    if not set(codes) <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}:
        raise BadInputError(here, "no filter, gzip or shuffle", f"HDF5 filters {codes}")
    if not kind.admits(dataset.dtype):
        raise BadInputError(here, kind.words, f"{dataset.dtype}")
    return dataset


def read_values(dataset: h5py.Dataset, kind: Kind, here: str) -> NDArray[Any]:
    """Read all values, unless the file holds fewer than the shape has."""
    stored = dataset.id.get_storage_size()
    if dataset.nbytes > stored * (_LARGEST_DEFLATION if dataset.chunks else 1):
        raise BadInputError(here, f"{dataset.size} values", f"{stored} bytes, too few to hold them")
    values = dataset[()]
    if kind is STRINGS:
        values = _read_texts(values.tolist(), here)
    elif kind is INTEGERS and np.any(values > np.iinfo(np.int64).max):
        raise BadInputError(here, "integers below 2**63", f"{values.max()}")
    return np.asarray(values, dtype=kind.read_as)


def _read_texts(values: list[object], here: str) -> list[str]:
    """Make texts, each distinct one once: a column of names has few."""
    first_row = {value: row for row, value in zip(range(len(values) - 1, -1, -1), reversed(values), strict=True)}
    texts = {value: read_text(value, f"{here}, row {row}") for value, row in first_row.items()}
    return [texts[value] for value in values]


def read_text(value: object, here: str) -> str:
    """Make text of a value that h5py returned for a string."""
    try:
        text = value.decode() if isinstance(value, bytes) else str(value)
    except UnicodeDecodeError as error:
        raise BadInputError(here, "UTF-8 text", repr(value)) from error
    if not text.isprintable():
        raise BadInputError(here, "printable text", repr(text))
    return text
