"""The measurement of drift: the events and months of a station's year, against the versions of its first year."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.model import Model
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.events import LARGEST_SHARE, EventModes, add_events, average_months, measure_event_modes
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, hash_content
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import SpectraBlock, split_into_blocks
from lbacal_core.spectra.screening import screen_block
from service.storage.database import Database, Stores
from service.storage.drift import DriftSource, MonthlyRatio, StoredModes
from service.storage.jobs import Part
from service.storage.spectra import Window
from service.storage.versions import Version
from service.usecases.drift import SECOND_US, find_years, keep_months
from service.usecases.fits import Fits

KIND = "drift"


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
class DriftMeasurement:
    """Measures the drift of a station's year."""

    database: Database
    simulation: Simulation
    resistance_ohm: float
    fits: Fits
    clock: Callable[[], Instant]

    def run(self, part: Part, worker: str) -> None:
        """Do a part: the events and months of a station's year, replaced whole.

        Events that came since the year was measured are added to those that are kept, where that gives the same.
        """
        station, since, until = part.request["station"], part.request["since"], part.request["until"]
        window = Window(since, until, Scope(station))
        with self.database.read() as stores:
            references = find_references(stores, self.simulation.instrument, station)
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
                    window,
                    self.simulation.instrument.frequency_mhz,
                    self.resistance_ohm,
                    with_covariates=not model.is_plain,
                )
            if spectra is not None and not model.is_plain:  # what an adopted cause does is no drift
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
        known = [
            self.simulation.instrument.digest_of(*ends, station),
            self.simulation.sky_power.digest(),
            MODEL_VERSION,
            model.id,
        ]
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
        channels, resistance = self.simulation.instrument.frequency_mhz, self.resistance_ohm
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
            more = before and add_events(before, block, curves, self.simulation)
            if more is None:
                return None
            events[block.dipole] = replace(more, ln_c=_as_kept(more.ln_c))
        return events

    def _measure(self, blocks: Sequence[SpectraBlock], references: Mapping[Scope, Version]) -> dict[str, EventModes]:
        """The events of the paths of whole blocks that have a reference, by dipole."""
        events = {}
        for block in blocks:
            screened = screen_block(block, self.simulation.instrument.at_station(block.station).longitude_deg).block
            curves = _curves_of(block.dipole, references)
            modes = measure_event_modes(screened, curves, self.simulation)
            times = np.round(modes.time_unix * SECOND_US) / SECOND_US
            events[block.dipole] = replace(modes, ln_c=_as_kept(modes.ln_c), time_unix=times)
        return events


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
