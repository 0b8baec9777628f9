"""Drift: C of every path, station and the array over time, against the first year; and what changed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.curves import CalibrationCurve
from lbacal_core.drift.events import EventModes, measure_event_modes
from lbacal_core.drift.later import LARGEST_SHARE, add_events
from lbacal_core.drift.monthly import average_months
from lbacal_core.drift.terms import SLOPE, smooth_columns
from lbacal_core.grids import Floats
from lbacal_core.in_words import name_path
from lbacal_core.instrument import Instrument
from lbacal_core.model import Model
from lbacal_core.provenance import MODEL_VERSION, hash_content
from lbacal_core.screening import screen_block
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock, split_into_blocks
from lbacal_core.validity import Instant, Promotion, Scope, timeline
from service.errors import NotFoundError
from service.storage.database import Database, Stores
from service.storage.drift import DriftSource, MonthlyRatio, StoredModes
from service.storage.jobs import Part
from service.storage.spectra import Window
from service.storage.versions import MeanC, Version
from service.usecases.calibrations import select_paths
from service.usecases.fits import Fits
from service.usecases.last_made import LastMade
from service.usecases.months import DIGITS, MonthPoint, keep_months, read_matrix, read_months
from service.usecases.story import Story, tell_story
from service.usecases.years import find_years
from service.wire.instants import format_instant

KIND = "drift"
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


def find_references(stores: Stores, instrument: Instrument, station: str) -> dict[Scope, str]:
    """Find for every path of a station its own version that is in effect for its first whole calendar year (UTC).

    Where windows are cut in every year, it is the one in effect at the middle of the first. A version that was made and
    not promoted changes nothing here.
    """
    antennas = sorted({record.antenna for record in instrument.antennas if record.station == station})
    paths = [Scope(station, antenna, dipole) for antenna in antennas for dipole in instrument.dipoles]
    found: dict[Scope, str] = {}
    of_cut: dict[Scope, str] = {}
    for since, until in find_years(stores):
        missing = [path for path in paths if path not in found]
        for path, said in stores.ledger.answers(missing, (since + until) // 2, None).items():
            newest = said[0] if said and said[0].scope == path else None
            if newest is None or newest.calibration is None:
                continue
            if newest.covers(since) and newest.covers(until - 1):
                found[path] = newest.calibration
            of_cut.setdefault(path, newest.calibration)
    return of_cut | found


@dataclass(frozen=True)
class Drift:
    """Measures drift and reports it."""

    database: Database
    instrument: Instrument
    sky_power: Callable[[], SkyPower]
    resistance_ohm: float
    fits: Fits
    shown: LastMade[Any]
    """What the page of the drift shows."""
    clock: Callable[[], Instant]

    def run(self, part: Part, worker: str) -> None:
        """Do a part: the events and months of a station's year, replaced whole.

        Events that came since the year was measured are added to those that are kept, where that gives the same.
        """
        station, since, until = part.request["station"], part.request["since"], part.request["until"]
        window = Window(since, until, Scope(station))
        with self.database.read() as stores:
            references = find_references(stores, self.instrument, station)
            versions = stores.versions.get_many(references.values())
            model = stores.models.during(station, since, until)
            source = self._name_source(stores, window, references, model)
            later = self._read_later(stores, window, source) if model.is_plain else None
        by_path = {scope: versions[name] for scope, name in references.items()}
        events = None if later is None else self._add(later, by_path)
        if events is None:
            source = replace(source, screened=source.spectra)
            with self.database.read() as stores:
                spectra = stores.spectra.load(
                    window, self.instrument.frequency_mhz, self.resistance_ohm, with_covariates=not model.is_plain
                )
            if spectra is not None:  # what an adopted cause does is no drift
                spectra = self.fits.fit_causes(spectra, model).spectra
            events = self._measure([] if spectra is None else split_into_blocks(spectra), by_path)
        measured = [
            _average(station, dipole, since, modes, by_path) for dipole, modes in events.items() if modes.antennas.size
        ]
        ratios = [ratio for of_dipole, _ in measured for ratio in of_dipole]
        with self.database.write() as stores:
            stores.drift.replace(station, since, until, ratios, [modes for _, modes in measured])
            stores.drift.keep_source(station, since, source)
            keep_months(stores, station, since, ratios)
            stores.jobs.complete(part, worker, {"calibrations": []}, self.clock())

    def _name_source(
        self, stores: Stores, window: Window, references: Mapping[Scope, str], model: Model
    ) -> DriftSource:
        """What a station's year is measured from now; `screened` as it was when the whole year was read last."""
        station, ends = str(window.scope.station), (window.since / SECOND_US, window.until / SECOND_US)
        known = [self.instrument.digest_of(*ends, station), self.sky_power().digest(), MODEL_VERSION, model.id]
        inputs = hash_content([sorted((path.key, name) for path, name in references.items()), *known])
        content, before = stores.spectra.content(window), stores.drift.source(station, window.since)
        screened = 0 if before is None else before.screened
        return DriftSource(inputs, *content, stores.spectra.newest_event(window), screened)

    def _read_later(
        self, stores: Stores, window: Window, source: DriftSource
    ) -> tuple[list[StoredModes], list[SpectraBlock]] | None:
        """The events that are kept of a year, and the spectra that came since; None where more than these changed."""
        station, before = str(window.scope.station), stores.drift.source(str(window.scope.station), window.since)
        if before is None or (before.inputs, before.flag) != (source.inputs, source.flag):
            return None
        if source.spectra > (1.0 + LARGEST_SHARE) * source.screened:
            return None
        channels, resistance = self.instrument.frequency_mhz, self.resistance_ohm
        spectra = stores.spectra.load_after(window, before.event, channels, resistance)
        count = 0 if spectra is None else len(spectra)
        if before.spectra + count != source.spectra:
            return None
        return stores.drift.modes(station, window.since), [] if spectra is None else split_into_blocks(spectra)

    def _add(
        self, later: tuple[list[StoredModes], list[SpectraBlock]], references: Mapping[Scope, Version]
    ) -> dict[str, EventModes] | None:
        """The events of a year by dipole, later ones added; None where the whole year is to be read."""
        kept, blocks = later
        events = {
            one.dipole: EventModes(
                np.array(one.antennas, dtype=np.int64), one.time_us / SECOND_US, one.ln_c.astype(float), _NO_CENTRE
            )
            for one in kept
        }
        for block in blocks:
            before = events.get(block.dipole)
            curves = _curves_of(block.dipole, references)
            more = before and add_events(before, block, curves, self.instrument, self.sky_power())
            if more is None:
                return None
            events[block.dipole] = replace(more, ln_c=_as_kept(more.ln_c))
        return events

    def _measure(self, blocks: Sequence[SpectraBlock], references: Mapping[Scope, Version]) -> dict[str, EventModes]:
        """The events of the paths of whole blocks that have a reference, by dipole."""
        events = {}
        for block in blocks:
            screened = screen_block(block, self.instrument.at_station(block.station).longitude_deg).block
            curves = _curves_of(block.dipole, references)
            modes = measure_event_modes(screened, curves, self.instrument, self.sky_power())
            times = np.round(modes.time_unix * SECOND_US) / SECOND_US
            events[block.dipole] = replace(modes, ln_c=_as_kept(modes.ln_c), time_unix=times)
        return events

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


_NO_CENTRE = np.empty((0, 2))
"""Kept events go without the means of their polynomials, which only their first measurement tells."""


def _as_kept(ln_c: Floats) -> Floats:
    """What is kept of measured modes, so that a year to which events were added is the same as one read whole."""
    return np.asarray(ln_c.astype(np.float32).astype(float))


def _curves_of(dipole: str, references: Mapping[Scope, Version]) -> dict[int, CalibrationCurve]:
    """The reference curves of a dipole by antenna."""
    return {int(str(scope.antenna)): one.curves[0] for scope, one in references.items() if scope.dipole == dipole}


def _average(
    station: str, dipole: str, since: Instant, modes: EventModes, references: Mapping[Scope, Version]
) -> tuple[list[MonthlyRatio], StoredModes]:
    """The months of events, and these as they are kept."""
    found, ratios = average_months(modes), []
    months = found.months.astype("datetime64[us]").astype(np.int64)
    for k, m in np.argwhere(np.isfinite(found.c_ratio)):
        path = Scope(station, int(found.antennas[k]), dipole)
        c_ratio, sigma = float(found.c_ratio[k, m]), float(found.c_ratio_sigma[k, m])
        events = int(found.events[k, m])
        shape, shape_sigma = ((float(v[k, m, 0]), float(v[k, m, 1])) for v in (found.shape, found.shape_sigma))
        month, reference = int(months[m]), references[path].id
        ratios.append(MonthlyRatio(path, month, reference, c_ratio, sigma, events, shape, shape_sigma))
    times = np.round(modes.time_unix * SECOND_US).astype(np.int64)
    antennas, ln_c = tuple(modes.antennas.tolist()), modes.ln_c.astype(np.float32)
    return ratios, StoredModes(station, dipole, since, antennas, times, ln_c)


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
