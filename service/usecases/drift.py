"""Drift: C of every path, station and the array over time, against the first year; and what changed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.curves.validity import Instant, Promotion, Scope, timeline
from lbacal_core.drift.model import SLOPE, smooth_columns
from lbacal_core.errors import name_path
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_content
from service.errors import NotFoundError
from service.storage.database import Database, Stores
from service.storage.versions import MeanC, Version
from service.usecases.calibrations import select_paths
from service.usecases.last_made import LastMade
from service.usecases.months import DIGITS, MonthPoint, read_matrix, read_months
from service.usecases.story import Story, tell_story
from service.wire.instants import format_instant

SECOND_US = 1_000_000
HALF_A_MONTH_S = 15 * 86_400.0


@dataclass(frozen=True)
class Step:
    """What changed at a date, as the report of the watch tells it, and the version in effect then."""

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
    """What is known of a scope over time; steps ranked from the most significant."""

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
    shown: LastMade[Any]
    """What the page of the drift shows."""

    def matrix(self, station: str) -> list[str]:
        """Every path of a station beside its median, one JSON text a year."""
        with self.database.read() as stores:
            return read_matrix(stores, station)

    def means_of_paths(self, station: str) -> list[MeanC]:
        """Band means of C of the newest versions in effect of a station's paths, path by path."""
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

    def version_at(self, path: Scope, instant: Instant) -> str:
        """The version of a path itself that answers at an instant; not found where there is none."""
        with self.database.read() as stores:
            decisive = stores.ledger.decisive([path], instant, None).get(path)
        if decisive is None or decisive.calibration is None:
            raise NotFoundError(
                f"no version of {name_path(*path.parts)} is in effect at {format_instant(instant)[:10]}"
            )
        return decisive.calibration

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

    def stories(self, series: Sequence[DriftSeries]) -> dict[tuple[str, str], Story]:
        """How and why each version of some scopes differs from the first, by version and polarisation."""
        with self.database.read() as stores:
            versions = stores.versions.get_many({mean.calibration for one in series for mean in one.versions})
        told: dict[tuple[str, str], Story] = {}
        for one in series:
            first: dict[str, Version] = {}
            for mean in sorted(one.versions, key=lambda mean: (mean.since, mean.calibration)):
                version = versions[mean.calibration]
                before = first.setdefault(mean.dipole, version)
                told[mean.calibration, mean.dipole] = tell_story(version, before, mean.dipole)
        return told

    def state(self) -> str:
        """Names what the drift is told from: the months, what the watch found in them, and what is in effect."""
        with self.database.read() as stores:
            return hash_content([stores.drift.state(), stores.ledger.newest_number()])

    def steps(self, count: int) -> list[Step]:
        """The most significant steps."""
        with self.database.read() as stores:
            return _steps(stores, Scope(), stores.drift.report(), count)


def find_means_in_effect(stores: Stores, scopes: Sequence[Scope]) -> list[MeanC]:
    """Find the band means of C of the versions that answer for some scopes at any time, as the ledger stands now.

    Versions that were replaced night by night, were withdrawn or wait at the gate are left out.
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
        own = [step for step in steps if _concerns(scope, step.change)]
        versions = [mean for mean in in_effect if mean.scope == scope]
        slope = None if report is None else _slope(scope, report)
        months = draw_line(_name_versions(of_scope.get(scope, []), versions), slope)
        found.append(DriftSeries(scope, versions, months, own, slope, threshold))
    return found


def _steps(stores: Stores, scope: Scope, report: Mapping[str, Any] | None, count: int | None = None) -> list[Step]:
    """The changes of a scope, each with the version of its path in effect then."""
    changes = [] if report is None else [one for one in report["changes"] if _concerns(scope, one)]
    steps = [Step(change, None) for change in changes[:count]]
    asked = [(step.path, step.date) for step in steps if step.path.antenna is not None]
    decisive = stores.ledger.decisive_at(asked)
    at = {pair: promotion.calibration for pair, promotion in decisive.items()}
    return [replace(step, calibration=at.get((step.path, step.date))) for step in steps]


def _concerns(scope: Scope, change: Mapping[str, Any]) -> bool:
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
