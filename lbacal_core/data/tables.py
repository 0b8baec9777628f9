"""The shipped tables of numbers; each file names its source in its first lines."""

from __future__ import annotations

import csv
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

SHIPPED = files("lbacal_core") / "data"


def read_table(name: str) -> dict[str, NDArray[np.float64]]:
    """Columns of a shipped table by name; NaN where a cell is empty."""
    lines = (SHIPPED / f"{name}.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    return {column: np.array([float(row[column] or "nan") for row in rows]) for column in rows[0]}
