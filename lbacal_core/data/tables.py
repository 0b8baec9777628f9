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


# What is LOFAR's and nobody else's: the letters of its dipoles, and where its stations stand.

DIPOLES = ("X", "Y")
SUPERTERP = "lofar-superterp"
"""The instrument that the published C(nu) and the published noise terms belong to."""
LOFAR_DEG = (52.9, 6.9)
LOFAR_RADIUS_DEG = 1.5
"""Latitude and longitude of LOFAR's core, and how far its Dutch stations reach: about 100 km."""
