"""Drift: C of every path, station and the array over time, against the first year; and where it jumps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.drift.events import measure_event_modes
from lbacal_core.drift.monthly import average_months
from lbacal_core.drift.steps import find_steps
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.screening import screen_block
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock, split_into_blocks
from lbacal_core.validity import Instant, Promotion, Scope, timeline
from service.storage.database import Database, Stores
from service.storage.drift import MonthlyRatio
from service.storage.jobs import Part
from service.storage.spectra import Window
from service.storage.versions import MeanC, Version
from service.usecases.calibrations import select_paths
from service.usecases.years import find_years

KIND = "drift"
BAND = (16.0, 50.0, 84.0)
"""Percentiles of the paths of a station: median and the middle 68 %."""


@dataclass(frozen=True)
class MonthPoint:
    """A month of one path: C over that of the reference; or of many: the median and the middle 68 % of their ratios."""

    month: Instant
    c_ratio: float
    low: float
    high: float
    paths: int
    events: int
    calibration: str | None


@dataclass(frozen=True)
class Step:
    """A jump of a path against its station's median: C changes by the fraction `size`."""

    path: Scope
    date: Instant
    size: float
    sigma: float
    calibration: str | None

    @property
    def significance(self) -> float:
        """|size| / sigma, not corrected for having tried every month."""
        return abs(self.size) / self.sigma


@dataclass(frozen=True)
class DriftSeries:
    """What is known of a scope over time; steps ranked from the most significant."""

    scope: Scope
    versions: Sequence[MeanC]
    months: Sequence[MonthPoint]
    steps: Sequence[Step]


def find_references(stores: Stores, instrument: Instrument, station: str) -> dict[Scope, str]:
    """Find for every path of a station its own version that is in effect for its first whole calendar year (UTC).

    A version that was made and not promoted changes nothing here.
    """
    antennas = sorted({record.antenna for record in instrument.antennas if record.station == station})
    paths = [Scope(station, antenna, dipole) for antenna in antennas for dipole in instrument.dipoles]
    found: dict[Scope, str] = {}
    for since, until in find_years(stores):
        missing = [path for path in paths if path not in found]
        for path, said in stores.ledger.answers(missing, (since + until) // 2, None).items():
            newest = said[0] if said and said[0].scope == path else None
            if newest is None or newest.calibration is None:
                continue
            if newest.covers(since) and newest.covers(until - 1):
                found[path] = newest.calibration
    return found


@dataclass(frozen=True)
class Drift:
    """Measures drift and reports it."""

    database: Database
    instrument: Instrument
    sky_power: Callable[[], SkyPower]
    resistance_ohm: float
    clock: Callable[[], Instant]

    def run(self, part: Part, worker: str) -> None:
        """Do a part: the monthly ratios of a station's year, replaced whole."""
        station, since, until = part.request["station"], part.request["since"], part.request["until"]
        with self.database.read() as stores:
            references = find_references(stores, self.instrument, station)
            versions = stores.versions.get_many(references.values())
            window = Window(since, until, Scope(station))
            spectra = stores.spectra.load(window, self.instrument.frequency_mhz, self.resistance_ohm)
        by_path = {scope: versions[name] for scope, name in references.items()}
        blocks = [] if spectra is None else split_into_blocks(spectra)
        ratios = [ratio for block in blocks for ratio in self._measure(block, by_path)]
        with self.database.write() as stores:
            stores.drift.replace(station, since, until, ratios)
            stores.jobs.complete(part, worker, {"calibrations": []}, self.clock())

    def _measure(self, block: SpectraBlock, references: Mapping[Scope, Version]) -> list[MonthlyRatio]:
        of_block = {s: v for s, v in references.items() if s.dipole == block.dipole}
        curves = {int(str(scope.antenna)): version.curves[0] for scope, version in of_block.items()}
        block = screen_block(block, self.instrument.longitude_deg).block
        found = average_months(measure_event_modes(block, curves, self.instrument, self.sky_power()))
        months = found.months.astype("datetime64[us]").astype(np.int64)
        ratios = []
        for k, m in np.argwhere(np.isfinite(found.c_ratio)):
            path = Scope(block.station, int(found.antennas[k]), block.dipole)
            c_ratio, sigma = float(found.c_ratio[k, m]), float(found.c_ratio_sigma[k, m])
            events = int(found.events[k, m])
            ratios.append(MonthlyRatio(path, int(months[m]), of_block[path].id, c_ratio, sigma, events))
        return ratios

    def ratios(self, station: str) -> list[MonthlyRatio]:
        """The months of all paths of a station."""
        with self.database.read() as stores:
            return stores.drift.ratios(Scope(station))

    def means_of_paths(self, station: str) -> list[MeanC]:
        """Band means of C of the versions in effect of a station's paths, path by path."""
        with self.database.read() as stores:
            means = find_means_in_effect(stores, select_paths(self.instrument, station, None, None))
        return sorted(means, key=lambda mean: (mean.scope.antenna or 0, mean.dipole, mean.since))

    def series(self, scope: Scope) -> DriftSeries:
        """Versions in effect, months and steps of a scope."""
        with self.database.read() as stores:
            ratios = stores.drift.ratios(Scope(scope.station))
            of_paths = find_means_in_effect(stores, select_paths(self.instrument, scope.station, None, None))
            of_scope = find_means_in_effect(stores, [scope])
        return _gather(scope, ratios, of_scope, _rank_steps(ratios, of_paths))

    def overall(self) -> tuple[DriftSeries, list[DriftSeries]]:
        """The array, and every station with spectra."""
        with self.database.read() as stores:
            ratios = stores.drift.ratios(Scope())
            of_paths = find_means_in_effect(stores, select_paths(self.instrument, None, None, None))
            scopes = [Scope(), *(Scope(station) for station in stores.spectra.stations())]
            of_scope = {scope: find_means_in_effect(stores, [scope]) for scope in scopes}
        steps = _rank_steps(ratios, of_paths)
        array, *stations = (_gather(scope, ratios, of_scope[scope], steps) for scope in scopes)
        return array, stations


def find_means_in_effect(stores: Stores, scopes: Sequence[Scope]) -> list[MeanC]:
    """Find the band means of C of the versions that answer for some scopes at any time, as the ledger stands now.

    Versions that were replaced night by night, were withdrawn or wait at the gate are left out.
    """
    of_scope: dict[Scope, list[Promotion]] = {scope: [] for scope in scopes}
    for promotion in stores.ledger.standing(scopes):
        of_scope[promotion.scope].append(promotion)
    stretches = (stretch for scope, promotions in of_scope.items() for stretch in timeline(promotions, scope))
    return stores.versions.means(stretch.calibration for stretch in stretches if stretch.calibration is not None)


def _gather(
    scope: Scope, ratios: Sequence[MonthlyRatio], versions: Sequence[MeanC], steps: Sequence[Step]
) -> DriftSeries:
    """Select what belongs to a scope."""
    own = [ratio for ratio in ratios if scope in ratio.path.widening]
    return DriftSeries(scope, versions, _months(own, versions), [step for step in steps if scope in step.path.widening])


def _months(ratios: Sequence[MonthlyRatio], versions: Sequence[MeanC]) -> list[MonthPoint]:
    by_month: dict[Instant, list[MonthlyRatio]] = {}
    for ratio in ratios:
        by_month.setdefault(ratio.month, []).append(ratio)
    points = []
    for month, of_month in sorted(by_month.items()):
        low, median, high = (float(v) for v in np.percentile([ratio.c_ratio for ratio in of_month], BAND))
        if len(of_month) == 1:
            low, high = median - of_month[0].c_ratio_sigma, median + of_month[0].c_ratio_sigma
        events = max(ratio.events for ratio in of_month)
        points.append(MonthPoint(month, median, low, high, len(of_month), events, _version_at(versions, month)))
    return points


def _version_at(versions: Sequence[MeanC], instant: Instant) -> str | None:
    """The version whose window holds an instant, the one made last."""
    return next((v.calibration for v in reversed(versions) if v.since <= instant < v.until), None)


def _rank_steps(ratios: Sequence[MonthlyRatio], versions: Sequence[MeanC]) -> list[Step]:
    """The best step of every path against the median of its station, the most significant first."""
    by_station: dict[str, list[MonthlyRatio]] = {}
    of_path: dict[Scope, list[MeanC]] = {}
    for ratio in ratios:
        by_station.setdefault(str(ratio.path.station), []).append(ratio)
    for mean in versions:
        of_path.setdefault(mean.scope, []).append(mean)
    steps = []
    for of_station in by_station.values():
        matrix = relative_to_station(of_station)
        if len(matrix.paths) < 2:
            continue  # a path divided by itself has no step
        found = find_steps(matrix.values, matrix.sigmas)
        for k, path in enumerate(matrix.paths):
            if np.isfinite(found.size[k]):
                date = _within_month(int(matrix.months[found.month[k]]), float(found.passed[k]))
                version = _version_at(of_path.get(path, []), date)
                steps.append(Step(path, date, float(found.size[k]), float(found.sigma[k]), version))
    return sorted(steps, key=lambda step: (-step.significance, step.path.key))


@dataclass(frozen=True)
class PathMatrix:
    """Paths of one station by month: their ratios over the station's median, shape (path, month); NaN where unknown."""

    paths: Sequence[Scope]
    months: NDArray[np.int64]
    values: Floats
    sigmas: Floats


def relative_to_station(ratios: Sequence[MonthlyRatio]) -> PathMatrix:
    """Divide out what the paths of a station have in common: the gain of an event, the season."""
    paths = list(dict.fromkeys(ratio.path for ratio in ratios))
    months = np.unique(np.array([ratio.month for ratio in ratios], dtype=np.int64))
    row = {path: k for k, path in enumerate(paths)}
    values, sigmas = np.full((2, len(paths), months.size), np.nan)
    for ratio in ratios:
        at = row[ratio.path], int(np.searchsorted(months, ratio.month))
        values[at], sigmas[at] = ratio.c_ratio, ratio.c_ratio_sigma
    median = np.array([np.median(column[np.isfinite(column)]) for column in values.T])
    return PathMatrix(paths, months, values / median, sigmas / median)


def _within_month(month: Instant, passed: float) -> Instant:
    start = np.datetime64(month, "us").astype("datetime64[M]")
    end = int((start + 1).astype("datetime64[us]").astype(np.int64))
    return month + round(passed * (end - month))
