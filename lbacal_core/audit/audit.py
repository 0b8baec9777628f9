"""The audit of a station: what is dead, mislabelled, on the wrong cable, turned, late or in the wrong unit.

Cables come first, because antennas are compared through them; then paths that do not work, which count nowhere; then
single antennas whose dipoles are exchanged; what the others saw of the sky comes last.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lbacal_core.audit.cables import find_wrong_cables
from lbacal_core.audit.exchange import compare_polarisations, tell_exchanged
from lbacal_core.audit.finding import UNDECIDED, WRONG, Line
from lbacal_core.audit.health import compare_paths, find_ill_paths
from lbacal_core.audit.series import mean_frequencies
from lbacal_core.audit.sky_match import SkyMatch, tell_unit
from lbacal_core.audit.sky_models import SkyModels, load_models
from lbacal_core.audit.station import FEWEST, AuditedStation, split_stations
from lbacal_core.audit.steps import STEPPED, find_steps
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.differences import DifferenceModels
from lbacal_core.spectra import Spectra


@dataclass(frozen=True)
class AuditReport:
    """The lines of an audit, and what was audited."""

    lines: Sequence[Line]
    stations: Sequence[AuditedStation]

    @property
    def is_healthy(self) -> bool:
        """Whether nothing was found to be wrong."""
        return all(line.verdict != WRONG for line in self.lines)

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {
            "healthy": self.is_healthy,
            "lines": [line.as_dict() for line in self.lines],
            "stations": [
                {
                    "station": station.name,
                    "antennas": int(station.antennas.size),
                    "spectra": int(np.isfinite(station.power[..., 0]).sum()),
                    "hours": round(station.hours, 3),
                }
                for station in self.stations
            ],
        }


def audit(
    spectra: Spectra,
    instrument: Instrument,
    sky: str | None = None,
    antenna: str | None = None,
    others: DifferenceModels | None = None,
) -> AuditReport:
    """Audit every station of some spectra.

    Parameters
    ----------
    sky, antenna
        Models of what a working station sees, by name or file; those that the instrument names unless given.
    others
        Models whose differences from these are the errors of what it sees; all that ship unless given.
    """
    stations = tuple(split_stations(spectra, instrument))

    @cache
    def models() -> SkyModels:
        """Not computed where no station needs them."""
        return load_models(instrument, mean_frequencies(spectra.frequency_mhz), sky, antenna, others)

    return _audit(stations, instrument, models)


def audit_antennas(stations: Sequence[AuditedStation], instrument: Instrument) -> AuditReport:
    """What antennas say against each other, without any model of the sky."""
    return _audit(tuple(stations), instrument, None)


def _audit(
    stations: Sequence[AuditedStation], instrument: Instrument, models: Callable[[], SkyModels] | None
) -> AuditReport:
    lines: list[Line] = []
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "All-NaN|Mean of empty|Degrees of freedom", RuntimeWarning
        )  # nothing recorded
        for station in stations:
            lines += _audit_station(station, instrument.at_station(station.name), models)
    return AuditReport(lines, stations)


def _audit_station(
    station: AuditedStation, instrument: Instrument, models: Callable[[], SkyModels] | None
) -> list[Line]:
    if station.antennas.size < FEWEST:
        everyone = np.arange(station.antennas.size)
        sentence = f"paths, cables and letters are compared in {FEWEST} antennas or more, here are {everyone.size}"
        alone = [Line("antennas", UNDECIDED, station.name, sentence), *find_steps(station, everyone)]
        models = None if len(alone) > 1 else models
        return alone if models is None else [*alone, *SkyMatch(station, instrument, models).tell(everyone)]
    as_recorded = compare_paths(station)
    is_off = find_ill_paths(station, as_recorded)[1].any(axis=1)
    working = np.flatnonzero(~is_off)
    of_unit = tell_unit(station, working, instrument)
    if of_unit:
        return of_unit  # what else would be compared is no power
    steps = find_steps(station, working)
    wrong_cables, found = find_wrong_cables(station, as_recorded, instrument)
    station = station.with_cables(found, instrument)
    comparison = compare_paths(station)
    ill, is_ill = find_ill_paths(station, comparison)
    is_usable = np.asarray(~is_ill.any(axis=1) & np.isfinite(comparison.level).all(axis=1))
    exchange = compare_polarisations(station, is_usable)
    if models is None or any(line.check == STEPPED for line in steps):
        # a series of two chains is no series of the sky
        return [*steps, *ill, *wrong_cables, *tell_exchanged(station, exchange)]
    match = SkyMatch(station, instrument, models)
    most, others = np.setdiff1d(exchange.rows, exchange.exchanged()), exchange.exchanged()
    if others.size and match.gain_of_exchange(most) > match.gain_of_exchange(others):
        exchange, most = exchange.flipped(), others
    of_sky = match.tell(most)
    if any(line.check == "unit" and line.verdict == WRONG for line in of_sky):
        return of_sky
    return [*steps, *ill, *wrong_cables, *tell_exchanged(station, exchange), *of_sky]
