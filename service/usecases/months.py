"""What the months of many paths say together, kept year by year.

Ten years of months of 576 paths are 69,000 numbers, of which a page shows the median and the middle 68 %. They are
computed when the months are measured, in the same transaction, and kept under the hash of these months. What the array
says is kept under the hashes of all stations; where a station has been measured since, it is computed when somebody
asks, until the watch has kept it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content
from service.storage.database import Stores
from service.storage.drift import MonthlyRatio, StoredYear
from service.usecases.years import end_of_year
from service.wire.instants import format_instant

BAND = (16.0, 50.0, 84.0)
"""Percentiles of the paths of a station: median and the middle 68 %."""
DIGITS = 6
ARRAY = ""


class MonthPoint(NamedTuple):
    """A month of one path: C over that of the reference; or of many: the median and the middle 68 % of their ratios.

    `shape` is the tilt and curvature of ln C; `line` what offset, season and slope make of the month, with its lower
    and upper end (one standard deviation): None where years are too few to tell.
    """

    month: Instant
    c_ratio: float
    low: float
    high: float
    paths: int
    events: int
    calibration: str | None
    shape: tuple[float, float] | None
    line: tuple[float, float, float] | None = None


def keep_months(stores: Stores, station: str, since: Instant, ratios: Sequence[MonthlyRatio]) -> None:
    """Keep what the months of a station's year say, in the transaction that replaced them."""
    months = [[r.path.key, r.month, r.reference, r.c_ratio, r.c_ratio_sigma, r.events, r.shape] for r in ratios]
    matrix = _write_matrix(relative_to_station(ratios))
    stores.drift.keep_year(StoredYear(station, since, hash_content(months), _write(summarise(ratios)), matrix))


def keep_missing(stores: Stores) -> int:
    """Keep what is not kept, or of other months than there are; how many years that were."""
    stations = sorted({station for of_year in stores.drift.inputs_of_years().values() for station in of_year})
    missing = [year for year in stores.drift.years(stations) if year.months is None]
    for year in missing:
        keep_months(stores, year.station, year.since, _ratios(stores, Scope(year.station), year.since))
    kept = _kept_of_array(stores)
    late = [since for since, inputs in _inputs_of_array(stores).items() if kept.get(since, ("", ""))[0] != inputs]
    for since in late:
        months = _write(summarise(_ratios(stores, Scope(), since)))
        stores.drift.keep_year(StoredYear(ARRAY, since, _inputs_of_array(stores)[since], months))
    return len(missing) + len(late)


def read_months(stores: Stores, scopes: Sequence[Scope]) -> dict[Scope, list[MonthPoint]]:
    """Read the months of the array, of stations or of paths; what is not kept is computed."""
    found: dict[Scope, list[MonthPoint]] = {}
    stations = [str(scope.station) for scope in scopes if scope.level == "station"]
    for year in stores.drift.years(stations):
        scope = Scope(year.station)
        months = summarise(_ratios(stores, scope, year.since)) if year.months is None else _read(year.months)
        found.setdefault(scope, []).extend(months)
    if Scope() in scopes:
        kept = _kept_of_array(stores)
        found[Scope()] = [
            month
            for since, inputs in sorted(_inputs_of_array(stores).items())
            for month in (
                _read(kept[since][1])
                if since in kept and kept[since][0] == inputs
                else summarise(_ratios(stores, Scope(), since))
            )
        ]
    for scope in scopes:
        if scope.antenna is not None:
            found[scope] = [_of_one(ratio) for ratio in stores.drift.ratios(scope)]
    return found


def read_matrix(stores: Stores, station: str) -> list[str]:
    """Every path of a station beside its median, one JSON text a year."""
    return [
        _write_matrix(relative_to_station(_ratios(stores, Scope(station), year.since)))
        if year.matrix is None
        else year.matrix
        for year in stores.drift.years([station], with_matrix=True)
    ]


def _kept_of_array(stores: Stores) -> dict[Instant, tuple[str, str]]:
    return {year.since: (year.inputs, str(year.months)) for year in stores.drift.years([ARRAY])}


def _inputs_of_array(stores: Stores) -> dict[Instant, str]:
    return {since: hash_content(of_year) for since, of_year in stores.drift.inputs_of_years().items()}


def _ratios(stores: Stores, scope: Scope, since: Instant) -> list[MonthlyRatio]:
    return stores.drift.ratios(scope, since, end_of_year(since))


def summarise(ratios: Sequence[MonthlyRatio]) -> list[MonthPoint]:
    """Take the median and the middle 68 % of the paths of every month."""
    by_month: dict[Instant, list[MonthlyRatio]] = {}
    for ratio in ratios:
        by_month.setdefault(ratio.month, []).append(ratio)
    points = []
    for _, of_month in sorted(by_month.items()):
        low, median, high = (float(v) for v in np.percentile([ratio.c_ratio for ratio in of_month], BAND))
        one = _of_one(of_month[0])
        known = [ratio.shape for ratio in of_month if ratio.shape is not None]
        shape = (float(np.median([s[0] for s in known])), float(np.median([s[1] for s in known]))) if known else None
        events = max(ratio.events for ratio in of_month)
        many = MonthPoint(one.month, median, low, high, len(of_month), events, None, shape)
        points.append(one if len(of_month) == 1 else many)
    return points


def _of_one(ratio: MonthlyRatio) -> MonthPoint:
    low, high = ratio.c_ratio - ratio.c_ratio_sigma, ratio.c_ratio + ratio.c_ratio_sigma
    return MonthPoint(ratio.month, ratio.c_ratio, low, high, 1, ratio.events, None, ratio.shape)


def _write(points: Iterable[MonthPoint]) -> str:
    rows = [
        [p.month, *(round(v, DIGITS) for v in (p.c_ratio, p.low, p.high)), p.paths, p.events, _rounded(p.shape)]
        for p in points
    ]
    return json.dumps(rows, separators=(",", ":"))


def _rounded(shape: tuple[float, float] | None) -> list[float] | None:
    return None if shape is None else [round(v, DIGITS) for v in shape]


def _read(text: str) -> list[MonthPoint]:
    return [
        MonthPoint(month, c_ratio, low, high, paths, events, None, None if shape is None else (shape[0], shape[1]))
        for month, c_ratio, low, high, paths, events, shape in json.loads(text)
    ]


@dataclass(frozen=True)
class PathMatrix:
    """Paths of one station by month: their ratios over the station's median, shape (path, month); NaN where unknown."""

    paths: Sequence[Scope]
    months: NDArray[np.int64]
    values: Floats


def relative_to_station(ratios: Sequence[MonthlyRatio]) -> PathMatrix:
    """Divide out what the paths of a station have in common: the gain of an event, the season."""
    paths = list(dict.fromkeys(ratio.path for ratio in ratios))
    months = np.unique(np.array([ratio.month for ratio in ratios], dtype=np.int64))
    row = {path: k for k, path in enumerate(paths)}
    values = np.full((len(paths), months.size), np.nan)
    for ratio in ratios:
        values[row[ratio.path], int(np.searchsorted(months, ratio.month))] = ratio.c_ratio
    median = np.array([np.median(column[np.isfinite(column)]) for column in values.T])
    return PathMatrix(paths, months, values / median)


def _write_matrix(found: PathMatrix) -> str:
    """A matrix as JSON that may stand in a page: changes of C, null where unknown."""
    content = {
        "months": [format_instant(int(month))[:7] for month in found.months],
        "paths": [[path.antenna, path.dipole] for path in found.paths],
        "values": [[round(v - 1.0, DIGITS) if np.isfinite(v) else None for v in row] for row in found.values.tolist()],
    }
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
