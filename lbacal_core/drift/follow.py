"""Everything that is known of an array over time: every path, every station's polarisations, and the whole.

A path is compared with the median of its station's paths of the same polarisation, which see the same sky in the same
event; these medians are compared with that of the stations; and that one is the whole. So a step of one path, one of a
station, and what all of them share are told apart, and each is reported once.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.drift.medians import FEWEST_COMPANIONS
from lbacal_core.drift.model import Series
from lbacal_core.drift.search import Found, search_series
from lbacal_core.drift.whole import Whole, measure_whole
from lbacal_core.grids import Floats

BOTH = "XY"
"""The polarisation of a group that has both."""


@dataclass(frozen=True)
class History:
    """ln(C / C_reference) of an array's paths in all events.

    Attributes
    ----------
    station, antenna, dipole
        Shape (path,).
    time_unix
        Shape (event,), rising.
    ln_c
        Shape (path, event, mode), NaN where nothing was measured.
    known_unix
        Dates at which a path's hardware changed, shape (path, change), infinite where there is none.
    """

    station: NDArray[np.str_]
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    time_unix: Floats
    ln_c: NDArray[np.float32]
    known_unix: Floats


@dataclass(frozen=True)
class Followed:
    """What was found.

    Attributes
    ----------
    groups
        (station, dipole) of each group of paths.
    paths
        Paths against their group's median.
    stations
        Groups against the median of the stations; None with fewer than three.
    whole
        The trend of what all share; None with fewer than three years.
    """

    groups: tuple[tuple[str, str], ...]
    paths: Found
    stations: Found | None
    whole: Whole | None


def follow(history: History) -> Followed:
    """Find what changed."""
    groups, group = _group_paths(history)
    paths = search_series(Series(history.ln_c, group, history.time_unix), history.known_unix)
    median = paths.median
    of_dipole = np.unique([dipole for _, dipole in groups], return_inverse=True)[1]
    stations = None
    if np.all(np.bincount(of_dipole) >= FEWEST_COMPANIONS):
        stations = search_series(Series(median, of_dipole, history.time_unix))
        median = stations.median
    return Followed(groups, paths, stations, measure_whole(history.time_unix, _average(median)))


def _group_paths(history: History) -> tuple[tuple[tuple[str, str], ...], NDArray[np.int64]]:
    """The groups, and which one each path belongs to: its station's polarisation, or all of a very small station."""
    keys = list(zip(history.station.tolist(), history.dipole.tolist(), strict=True))
    few = {station for (station, _), count in Counter(keys).items() if count < FEWEST_COMPANIONS}
    keys = [(station, BOTH if station in few else dipole) for station, dipole in keys]
    groups = tuple(sorted(set(keys)))
    return groups, np.array([groups.index(key) for key in keys])


def _average(median: NDArray[np.float32]) -> Floats:
    """Mean of several medians, shape (event, mode), each less its mean over time; NaN where none is known."""
    is_known = np.isfinite(median)
    filled = np.where(is_known, median, 0.0).astype(float)
    level = filled.sum(axis=1, keepdims=True) / np.maximum(is_known.sum(axis=1, keepdims=True), 1)
    count = is_known.sum(axis=0)
    mean = np.where(is_known, filled - level, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.asarray(np.where(count > 0, mean, np.nan))
