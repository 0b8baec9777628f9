"""The shipped tables of numbers; each file names its source in its first lines."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHIPPED = files("lbacal_core") / "data"


def read_table(name: str) -> dict[str, NDArray[np.float64]]:
    """Columns of a shipped table, such as ``published_calibration``, by name, shape (row,).

    NaN where a cell is empty. Tables are the files `lbacal_core/data/NAME.csv`.
    """
    return read_columns(SHIPPED / f"{name}.csv")


def read_columns(path: Traversable) -> dict[str, NDArray[np.float64]]:
    """Columns of a table by name, shape (row,).

    Lines that begin with # are left out, and a cell that is empty is NaN.
    """
    lines = path.read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    return {column: np.array([float(row[column] or "nan") for row in rows]) for column in rows[0]}


def read_content(name: str) -> Any:
    """The content of a shipped JSON file, `lbacal_core/data/NAME.json`."""
    return json.loads((SHIPPED / f"{name}.json").read_text())


# The one prior of nature: by how much each thing may be other than it is simulated, with its source.


@dataclass(frozen=True)
class Departure:
    """One standard deviation of what may be wrong.

    Attributes
    ----------
    sizes
        One number, or one for each order of a series.
    of
        What departs, in words.
    source
        Where the numbers come from.
    at_mhz
        The channels of the numbers, where they are a spectrum.
    """

    sizes: tuple[float, ...]
    of: str
    source: str
    at_mhz: Sequence[float] = ()

    @property
    def size(self) -> float:
        """The one number of `sizes`, which must not be a series."""
        (size,) = self.sizes
        return size


@cache
def read_prior() -> dict[str, Departure]:
    """Read the table of `lbacal_core/data/prior.toml`: every departure by its name."""
    rows = tomllib.loads((SHIPPED / "prior.toml").read_text(encoding="utf-8"))
    return {name: Departure(tuple(np.atleast_1d(row.pop("size")).tolist()), **row) for name, row in rows.items()}
