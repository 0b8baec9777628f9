"""The measurement of drift: the events and months of a station's year, against the versions of its first year."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal.instants import SECOND_US
from lbacal_core.causes.model import Model
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.events import EventModes, add_events, average_months, measure_spectra
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_content
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.screening import LARGEST_SHARE_OF_LATER
from lbacal_core.spectra.spectra import Spectra
from service.storage.database import Database, Stores
from service.storage.drift import NUMBERS, PathMonths
from service.storage.jobs import Order, Part
from service.storage.spectra import Window
from service.storage.sums import DRIFT, Sums
from service.usecases.drift import find_years, keep_months
from service.usecases.fits import Fits, Later, read_block

KIND = DRIFT


def find_references(stores: Stores, instrument: Instrument, station: str) -> dict[Scope, str]:
    """Find for every path of a station the version that its drift is measured against.

    That is its own one in effect at the middle of its first calendar year (UTC) with one, as it would be if no change
    cut that year: drift finds changes, and against what it called for itself it would find others, without end.
    """
    antennas = sorted({record.antenna for record in instrument.antennas if record.station == station})
    paths = [Scope(station, antenna, dipole) for antenna in antennas for dipole in instrument.dipoles]
    found: dict[Scope, str] = {}
    for since, until in find_years(stores):
        middle = (since + until) // 2
        own = stores.ledger.versions_at((path for path in paths if path not in found), middle)
        uncut = stores.versions.uncut(own.values(), middle)
        found |= {path: uncut[name] for path, name in own.items()}
    return found


@dataclass(frozen=True)
class DriftMeasurement:
    """Measures the drift of a station's year."""

    database: Database
    fits: Fits
    name_now: Callable[[Stores, Part], Order | None]
    clock: Callable[[], Instant]

    def run(self, part: Part, worker: str) -> None:
        """Do a part: the events and months of a station's year, replaced whole.

        Events that came since the year was measured are added to those that are kept, where that gives the same.
        """
        simulation, station = self.fits.simulation, Scope(part.request["station"])
        window = Window(part.request["since"], part.request["until"], station)
        with self.database.read() as stores:
            read = self.name_now(stores, part)
            references = find_references(stores, simulation.instrument, str(station.station))
            versions = stores.versions.get_many(references.values())
            model = stores.models.during(station.station, window.since, window.until)
            named = [sorted((path.key, name) for path, name in references.items()), model.id]
            of_simulation = self.fits.name_simulation(window.since, window.until, station)
            block = read_block(stores, KIND, window, hash_content([named, of_simulation]), station)
            later = self.fits.read_later(stores, block, window) if model.is_plain else None
        curves = {
            dipole: {
                int(str(p.antenna)): versions[name].curves[0] for p, name in references.items() if p.dipole == dipole
            }
            for dipole in simulation.instrument.dipoles
        }
        events = None if later is None else self.fits.elsewhere(_add, block, later, curves)
        if later is None or events is None:
            with self.database.read() as stores:
                channels, resistance = simulation.instrument.frequency_mhz, self.fits.resistance_ohm
                spectra = stores.spectra.load(window, channels, resistance, with_covariates=not model.is_plain)
            events = {} if spectra is None else self.fits.elsewhere(_measure, spectra, model, curves)
        else:
            block = replace(block, whole=later.block.whole)
        events = {dipole: modes for dipole, modes in events.items() if modes.antennas.size}
        with self.database.write() as stores:
            stores.sums.put(replace(block, arrays=write_events(events)))
            keep_months(stores, str(station.station), window.since, average(str(station.station), events))
            stores.jobs.complete(part, worker, {"calibrations": []}, self.clock(), read)


Curves = Mapping[str, Mapping[int, CalibrationCurve]]
"""The reference of every path, by dipole and antenna."""


def _add(fits: Fits, now: Sums, later: Later, curves: Curves) -> dict[str, EventModes] | None:
    """The events of a year by dipole, later ones added; None where the whole year is to be read."""
    if now.spectra > (1.0 + LARGEST_SHARE_OF_LATER) * later.block.whole:
        return None
    events = read_events(later.block.arrays)
    for block in [] if later.spectra is None else split_into_blocks(later.spectra):
        before = events.get(block.dipole)
        more = before and add_events(before, block, curves[block.dipole], fits.simulation)
        if more is None:
            return None
        events[block.dipole] = more
    return events


def _measure(fits: Fits, spectra: Spectra, model: Model, curves: Curves) -> dict[str, EventModes]:
    """The events of the paths that have a reference, by dipole; what an adopted cause does is no drift."""
    without = spectra if model.is_plain else fits.fit_causes(spectra, model).spectra
    measured = measure_spectra(without, lambda _, dipole: curves[dipole], fits.simulation)
    return {dipole: modes for _, dipole, modes in measured}


def write_events(events: Mapping[str, EventModes]) -> dict[str, Any]:
    """Write the events of a station's year as arrays by name: whole microseconds, and ln C in single precision."""
    return {
        f"{dipole}.{name}": values
        for dipole, modes in events.items()
        for name, values in (
            ("antennas", modes.antennas),
            ("time_us", np.round(modes.time_unix * SECOND_US).astype(np.int64)),
            ("ln_c", modes.ln_c.astype(np.float32)),
        )
    }


def read_events(arrays: Mapping[str, Any]) -> dict[str, EventModes]:
    """Read what `write_events` wrote, by dipole, in single precision."""
    return {
        dipole: EventModes(
            arrays[f"{dipole}.antennas"], arrays[f"{dipole}.time_us"] / SECOND_US, arrays[f"{dipole}.ln_c"]
        )
        for dipole in sorted({name.partition(".")[0] for name in arrays})
    }


def average(station: str, events: Mapping[str, EventModes]) -> PathMonths:
    """The months of a station's events, as these are kept: a year that was added to is the same as one read whole."""
    averaged = {dipole: average_months(modes) for dipole, modes in read_events(write_events(events)).items()}
    months = np.unique(np.concatenate([found.months for found in averaged.values()] or [np.zeros(0, "datetime64[M]")]))
    paths, ratios = list[Scope](), np.full((0, months.size, len(NUMBERS)), np.nan)
    for dipole, found in averaged.items():
        own = np.full((found.antennas.size, months.size, len(NUMBERS)), np.nan)
        own[:, np.searchsorted(months, found.months)] = np.stack(
            [found.c_ratio, found.c_ratio_sigma, *np.moveaxis(found.shape, 2, 0), found.events], axis=2
        )
        paths += [Scope(station, antenna, dipole) for antenna in found.antennas.tolist()]
        ratios = np.concatenate([ratios, own])
    is_known = np.isfinite(ratios[..., 0])
    rows, columns = np.flatnonzero(is_known.any(axis=1)), np.flatnonzero(is_known.any(axis=0))
    instants = months[columns].astype("datetime64[us]").astype(np.int64)
    return PathMonths([paths[k] for k in rows], instants, ratios[np.ix_(rows, columns)])
