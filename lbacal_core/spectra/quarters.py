"""Spectra are named path by path and quarter by quarter, and a window by the sorted hashes of its quarters.

A spectrum that arrives late changes the hash of one quarter of one path; all others are what they were.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_arrays, hash_content

Path = tuple[str, int, str]
"""Station, antenna and dipole."""
Quarters = Mapping[Path, Mapping[int, str]]
"""The hash of what each path recorded in each quarter, by the number of the quarter."""
MONTHS = 3


def number_quarters(time_unix: Floats) -> NDArray[np.int64]:
    """Quarters of the calendar (UTC) since 1970 that instants, s UTC, lie in."""
    months = np.floor(time_unix).astype("datetime64[s]").astype("datetime64[M]")
    return np.asarray(months.astype(np.int64) // MONTHS)


def hash_quarters(
    paths: Sequence[Path],
    path_of: NDArray[np.int64],
    order: NDArray[np.int64],
    time_unix: Floats,
    columns: Sequence[Any],
) -> Quarters:
    """The hash of what each path recorded in each quarter.

    Parameters
    ----------
    path_of
        Number of the path of each row, shape (row,).
    order
        Rows in order of path and event: the order in which they are stored does not count.
    columns
        What is recorded, one entry a row each.
    """
    quarter = number_quarters(time_unix)
    order = order[np.lexsort((quarter[order], path_of[order]))]
    ends = np.flatnonzero(np.diff(path_of[order]) | np.diff(quarter[order])) + 1
    found: dict[Path, dict[int, str]] = {}
    for rows in np.split(order, ends) if order.size else []:
        station, antenna, dipole = paths[path_of[rows[0]]]
        number = int(quarter[rows[0]])
        of_rows = hash_arrays(*(column[rows] for column in columns))
        of_path = found.setdefault((station, antenna, dipole), {})
        of_path[number] = hash_content([station, antenna, dipole, number, of_rows])
    return found


def pick_hashes(quarters: Quarters, station: str | None, antenna: int | None, dipole: str | None) -> list[str]:
    """The hashes of one path, or of all paths with what of the name is given."""
    if station is not None and antenna is not None and dipole is not None:
        return list(quarters.get((station, antenna, dipole), {}).values())
    asked = (station, antenna, dipole)
    named = [path for path in quarters if all(want in (None, have) for want, have in zip(asked, path, strict=True))]
    return [value for path in named for value in quarters[path].values()]


def hash_window(frequency_mhz: Floats, resistance_ohm: float, width_mhz: Floats | None, hashes: Iterable[str]) -> str:
    """The hash of all spectra of a window, from those of its quarters in any order."""
    grid = hash_arrays(frequency_mhz, [resistance_ohm], [] if width_mhz is None else width_mhz)
    return hash_content([grid, sorted(hashes)])
