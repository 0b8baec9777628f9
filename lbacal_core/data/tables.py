"""The shipped tables of numbers; each file names its source in its first lines."""

from __future__ import annotations

import csv
from importlib.resources import files
from importlib.resources.abc import Traversable

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
