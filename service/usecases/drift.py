"""Drift: C of every path, station and the array over time, against the first year; and what changed."""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from lbacal.instants import SECOND_US, format_instant, parse_instant
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.curves.validity import Instant, Promotion, Scope, timeline
from lbacal_core.drift.model import SLOPE, smooth_columns
from lbacal_core.errors import write_percent
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import Remembered, hash_content
from service.storage.database import Database, Stores
from service.storage.drift import PathMonths, StoredYear
from service.storage.versions import MeanC, Version
from service.usecases.calibrations import select_paths
from service.usecases.gate import find_change_of_mean

# Calendar years: the windows of the scheduled fits.


def find_years(stores: Stores) -> Iterator[tuple[Instant, Instant]]:
    """The calendar years (UTC) from the first event to the last, as half-open windows."""
    span = stores.spectra.span()
    if span is None:
        return
    first, last = (datetime.fromtimestamp(instant / 1e6, UTC).year for instant in span)
    for year in range(first, last + 1):
        yield start_of_year(year), start_of_year(year + 1)


def split_years(stores: Stores, since: Instant, until: Instant) -> Iterator[tuple[Instant, Instant]]:
    """The part of a window in each calendar year from the first event to the last."""
    for first, last in find_years(stores):
        if max(first, since) < min(last, until):
            yield max(first, since), min(last, until)


def start_of_year(year: int) -> Instant:
    """The first instant of a year, UTC."""
    return parse_instant("year", f"{year}-01-01")


def year_of(instant: Instant) -> tuple[Instant, Instant]:
    """The calendar year of an instant, UTC, as a half-open window."""
    year = datetime.fromtimestamp(instant / 1e6, UTC).year
    return start_of_year(year), start_of_year(year + 1)


# What the months of many paths say together, kept year by year.
#
# Ten years of months of 576 paths are 69,000 numbers, of which a page shows the median and the middle 68 %. They are
# computed when the months are measured, in the same transaction: those of the station, and those of the array.

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
    shape: tuple[float, float]
    line: tuple[float, float, float] | None = None


def keep_months(stores: Stores, station: str, since: Instant, months: PathMonths) -> None:
    """Keep the months of a station's year, and what they say, in the transaction that replaces its events."""
    stores.drift.lock()  # another station of the year, measured at the same time, must see these months
    summary, matrix = _write(summarise([months])), _write_matrix(months)
    stores.drift.keep_year(StoredYear(station, since, months.digest, summary, matrix, months))
    of_array = _write(summarise(stores.drift.months_of_paths(None, since)))
    stores.drift.keep_year(StoredYear(ARRAY, since, hash_content(of_array), of_array))


def read_months(stores: Stores, scopes: Sequence[Scope]) -> dict[Scope, list[MonthPoint]]:
    """Read the months of the array, of stations or of paths."""
    found: dict[Scope, list[MonthPoint]] = {}
    for year in stores.drift.years([scope.station or ARRAY for scope in scopes if scope.antenna is None]):
        found.setdefault(Scope(year.station or None), []).extend(_read(year.months))
    for scope in scopes:
        if scope.antenna is not None:
            found[scope] = [
                point
                for year in stores.drift.months_of_paths(scope.station)
                if scope in year.paths
                for point in summarise([replace(year, ratios=year.ratios[[year.paths.index(scope)]])])
            ]
    return found


def summarise(parts: Sequence[PathMonths]) -> list[MonthPoint]:
    """Take the median and the middle 68 % of the paths of every month; of a single path its value and error."""
    points = []
    for month in sorted({month for part in parts for month in part.months.tolist()}):
        of_month = np.concatenate(
            [part.ratios[:, part.months == month][:, 0] for part in parts if month in part.months]
        )
        ratio, sigma, tilt, curvature, events = of_month[np.isfinite(of_month[:, 0])].T
        if ratio.size:
            middle = float(np.median(ratio))
            ends = (middle - sigma[0], middle, middle + sigma[0]) if ratio.size == 1 else np.percentile(ratio, BAND)
            low, c_ratio, high = (float(end) for end in ends)
            shape = float(np.median(tilt)), float(np.median(curvature))
            points.append(MonthPoint(month, c_ratio, low, high, ratio.size, int(events.max()), None, shape))
    return points


def _write(points: Iterable[MonthPoint]) -> str:
    rows = [[p.month, *_round(p.c_ratio, p.low, p.high), p.paths, p.events, _round(*p.shape)] for p in points]
    return json.dumps(rows, separators=(",", ":"))


def _round(*values: float) -> list[float]:
    return [round(value, DIGITS) for value in values]


def _read(text: str) -> list[MonthPoint]:
    return [
        MonthPoint(month, c_ratio, low, high, paths, events, None, (tilt, curvature))
        for month, c_ratio, low, high, paths, events, (tilt, curvature) in json.loads(text)
    ]


def _write_matrix(months: PathMonths) -> str:
    """Every path of a station beside its median, as JSON that may stand in a page: changes of C, null where unknown.

    So what the paths have in common is divided out: the gain of an event, the season.
    """
    ratios = months.ratios[..., 0]
    beside = ratios / [np.median(column[np.isfinite(column)]) for column in ratios.T]
    content = {
        "months": [format_instant(int(month))[:7] for month in months.months],
        "paths": [[path.antenna, path.dipole] for path in months.paths],
        "values": [[round(v - 1.0, DIGITS) if np.isfinite(v) else None for v in row] for row in beside.tolist()],
    }
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")


# Why versions of a station stand beside its monthly line: which of what they are made from is another.

NOTICEABLE = 2.0
"""Standard deviations from which on a noise constant is told to be another."""
LEAST_CABLES = 0.001
"""A smaller change of C by the cables of other antennas is not told: errors of a version are ten times it."""


@dataclass(frozen=True)
class VersionPoint:
    """How a version stands beside the first of its scope and polarisation.

    Attributes
    ----------
    change, sigma
        Change of the mean of C over the band through one and the same cable, a fraction, with the error of both; 0 of
        the first itself.
    why
        What else is another, in words.
    """

    mean: MeanC
    change: float
    sigma: float
    why: str

    @classmethod
    def of(cls, means: Sequence[MeanC], versions: Mapping[str, Version]) -> list[VersionPoint]:
        """The versions of a scope, in order of polarisation and time."""
        points, first = [], dict[str, MeanC]()
        for mean in sorted(means, key=lambda one: (one.dipole, one.since, one.calibration)):
            before = first.setdefault(mean.dipole, mean)
            now, then = (versions[one.calibration] for one in (mean, before))
            change = find_change_of_mean(now, then, mean.dipole) or 0.0
            sigma = (1.0 + change) * math.hypot(mean.c_sigma / mean.c, before.c_sigma / before.c)
            is_first = mean.calibration == before.calibration
            points.append(cls(mean, change, 0.0 if is_first else sigma, explain_version(now, then, mean.dipole)))
        return points


def explain_version(version: Version, first: Version, dipole: str) -> str:
    """Explain the differences between a version and the first of its polarisation, besides the spectra; in words."""
    if version.id == first.id:
        return "the first"
    now, before = version.chains.get(dipole), first.chains.get(dipole)
    told = []
    if now is not None and before is not None and now.member_set != before.member_set:
        gone, new = len(before.member_set - now.member_set), len(now.member_set - before.member_set)
        told.append(f"other antennas ({gone} left out, {new} more)" + _tell_cables(before, now))
    was, is_now = (one.curve_of(dipole).parameters for one in (first, version))
    for name in is_now:
        if name not in was:
            continue
        change = is_now[name].value / was[name].value - 1.0
        sigma = math.hypot(was[name].sigma / was[name].value, is_now[name].sigma / is_now[name].value)
        if abs(change) > NOTICEABLE * sigma:
            told.append(f"N_{name.removeprefix('n_').upper()} {change:+.0%} ± {sigma:.0%}")
    return ", ".join(told) or "the same antennas, noise constants within their errors"


def _tell_cables(before: ReferenceChain, now: ReferenceChain) -> str:
    """What the mean loss of other cables does to C, which is as L_ref^-1/2."""
    change = float(np.median((before.mean_loss / now.mean_loss) ** 0.5)) - 1.0
    return "" if abs(change) < LEAST_CABLES else f", whose cables change C by {write_percent(change, 1)}"


HALF_A_MONTH_S = 15 * 86_400.0


@dataclass(frozen=True)
class Step:
    """A step at a date, from the report of the watch, and the version in effect then."""

    change: Mapping[str, Any]
    calibration: str | None

    @property
    def date(self) -> Instant:
        """The most probable date."""
        return round(float(self.change["date_unix"]) * SECOND_US)

    @property
    def path(self) -> Scope:
        """The path that steps; the station where several do."""
        first, *others = self.change["members"]
        station = self.change["station"]
        is_one_path = not others and first["antenna"] is not None
        return Scope(station, first["antenna"], first["dipole"]) if is_one_path else Scope(station)


@dataclass(frozen=True)
class DriftSeries:
    """The drift of a scope; steps ranked from the most significant."""

    scope: Scope
    versions: Sequence[MeanC]
    months: Sequence[MonthPoint]
    steps: Sequence[Step]
    slope: Mapping[str, Any] | None
    threshold_sigma: float | None


@dataclass(frozen=True)
class Drift:
    """Reports what was measured of drift."""

    database: Database
    instrument: Instrument
    shown: Remembered[str, Any]
    """What the page of the drift shows."""

    def means_of_paths(self, station: str) -> list[MeanC]:
        """Band means of C of the newest versions in effect of a station's paths, path by path; empty without any."""
        paths = select_paths(self.instrument, station, None, None)
        with self.database.read() as stores:
            latest = stores.ledger.latest(paths).values()
            means = stores.versions.means(p.calibration for p in latest if p.calibration is not None)
        return sorted(means, key=lambda mean: (mean.scope.antenna or 0, mean.dipole, mean.since))

    def slopes_of_paths(self, station: str) -> dict[Scope, Mapping[str, Any]]:
        """The slope of each of a station's paths beside their median, as the watch found it last."""
        with self.database.read() as stores:
            slopes = (stores.drift.report() or {"slopes": []})["slopes"]
        of_station = [one for one in slopes if one["station"] == station and one["antenna"] is not None]
        return {Scope(station, one["antenna"], one["dipole"]): one for one in of_station}

    def series(self, scope: Scope) -> DriftSeries:
        """Versions in effect, months, steps and slope of a scope."""
        with self.database.read() as stores:
            return _gather(stores, [scope], stores.drift.report())[0]

    def overall(self) -> tuple[DriftSeries, list[DriftSeries]]:
        """The array, and every station with spectra."""
        with self.database.read() as stores:
            scopes = [Scope(), *(Scope(station) for station in stores.spectra.stations())]
            array, *stations = _gather(stores, scopes, stores.drift.report())
        return array, stations

    def points(self, series: DriftSeries) -> list[VersionPoint]:
        """The versions of a scope, each beside the first of its polarisation."""
        with self.database.read() as stores:
            versions = stores.versions.get_many(mean.calibration for mean in series.versions)
        return VersionPoint.of(series.versions, versions)

    def state(self) -> str:
        """Names what the drift is told from: the months, what the watch found in them, and what is in effect."""
        with self.database.read() as stores:
            return hash_content([stores.drift.state(), stores.ledger.newest_number()])


def find_means_in_effect(stores: Stores, scopes: Sequence[Scope]) -> list[MeanC]:
    """Find the band means of C of the versions that answer for some scopes at any time, as the ledger stands now.

    Versions that were replaced day by day, were withdrawn or wait at the gate are left out.
    """
    of_scope: dict[Scope, list[Promotion]] = {scope: [] for scope in scopes}
    for promotion in stores.ledger.standing(scopes):
        of_scope[promotion.scope].append(promotion)
    stretches = (stretch for scope, promotions in of_scope.items() for stretch in timeline(promotions, scope))
    return stores.versions.means(stretch.calibration for stretch in stretches if stretch.calibration is not None)


def _gather(stores: Stores, scopes: Sequence[Scope], report: Mapping[str, Any] | None) -> list[DriftSeries]:
    """Gather what belongs to some scopes."""
    of_scope, in_effect = read_months(stores, scopes), find_means_in_effect(stores, scopes)
    threshold = None if report is None else float(report["threshold_sigma"])
    steps = _steps(stores, Scope() if Scope() in scopes else scopes[0], report)
    found = []
    for scope in scopes:
        own = [step for step in steps if is_of_step(scope, step.change)]
        versions = [mean for mean in in_effect if mean.scope == scope]
        slope = None if report is None else _slope(scope, report)
        months = draw_line(_name_versions(of_scope.get(scope, []), versions), slope)
        found.append(DriftSeries(scope, versions, months, own, slope, threshold))
    return found


def _steps(stores: Stores, scope: Scope, report: Mapping[str, Any] | None) -> list[Step]:
    """The changes of a scope, each with the version of its path in effect then."""
    changes = [] if report is None else [one for one in report["changes"] if is_of_step(scope, one)]
    steps = [Step(change, None) for change in changes]
    asked = [(step.path, step.date) for step in steps if step.path.antenna is not None]
    decisive = stores.ledger.decisive_at(asked)
    at = {pair: promotion.calibration for pair, promotion in decisive.items()}
    return [replace(step, calibration=at.get((step.path, step.date))) for step in steps]


def is_of_step(scope: Scope, change: Mapping[str, Any]) -> bool:
    """Whether a scope is one of those that a step concerns."""
    if scope.station is None or scope.antenna is None:
        return scope.station in (None, change["station"])
    mine = {(scope.antenna, scope.dipole), (None, scope.dipole)}
    return scope.station == change["station"] and any((m["antenna"], m["dipole"]) in mine for m in change["members"])


def _slope(scope: Scope, report: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The slope of a path beside its station; of a station or the array, that of C itself."""
    if scope.antenna is None:
        found: Mapping[str, Any] | None = report["trends"].get(scope.station or "array")
        return found
    slopes = (one for one in report["slopes"] if (one["station"], one["antenna"], one["dipole"]) == scope.parts)
    return next(slopes, None)


def _name_versions(months: Sequence[MonthPoint], versions: Sequence[MeanC]) -> list[MonthPoint]:
    """Give every month the version whose window holds it, of several the one made last."""
    starts = [point.month for point in months]
    names: list[str | None] = [None] * len(starts)
    for version in versions:
        first, last = bisect_left(starts, version.since), bisect_left(starts, version.until)
        names[first:last] = [version.calibration] * (last - first)
    return [point._replace(calibration=name) for point, name in zip(months, names, strict=True)]


def draw_line(months: list[MonthPoint], trend: Mapping[str, Any] | None) -> list[MonthPoint]:
    """Give every month what offset, season and slope make of it, where there is a trend."""
    if trend is None or "middle_unix" not in trend or not months:
        return months
    time_unix = np.array([point.month for point in months]) / SECOND_US + HALF_A_MONTH_S
    columns = smooth_columns(time_unix, trend["middle_unix"])
    line = columns[:, 1:SLOPE] @ np.array(trend["season"]) + columns[:, SLOPE] * trend["slope"]
    line += np.mean(np.log([point.c_ratio for point in months]) - line)
    sigma = np.hypot(trend["sigma"] * columns[:, SLOPE], trend["scatter"] / trend["years"] ** 0.5)
    ends = np.exp(np.stack([line, line - sigma, line + sigma], axis=1)).round(DIGITS).tolist()
    return [point._replace(line=tuple(three)) for point, three in zip(months, ends, strict=True)]
