"""The audit of a station: what is dead, mislabelled, on the wrong cable, turned, late or in the wrong unit.

Cables come first, because antennas are compared through them; then paths that do not work, which count nowhere; then
single antennas whose dipoles are exchanged; what the others saw of the sky comes last.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.antennas import (
    STEPPED,
    compare_paths,
    compare_polarisations,
    find_copies,
    find_empty_channels,
    find_ill_paths,
    find_steps,
    find_wrong_cables,
    tell_exchanged,
)
from lbacal_core.audit.moved import find_moved, put_in_place
from lbacal_core.audit.sky_match import SkyMatch, SkyModels, load_models, tell_unit
from lbacal_core.audit.station import FEWEST, AuditedStation, mean_frequencies, split_stations
from lbacal_core.audit.verdict import ALIKE, UNDECIDED, WRONG, Line
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.curves.curves import FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.spectra.spectra import Spectra


@dataclass(frozen=True)
class AuditReport:
    """The lines of an audit, and what was audited."""

    lines: Sequence[Line]
    stations: Sequence[AuditedStation]

    @property
    def wrong(self) -> list[Line]:
        """The lines that say that something is wrong."""
        return [line for line in self.lines if line.verdict == WRONG]

    @property
    def is_healthy(self) -> bool:
        """Whether nothing was found to be wrong."""
        return not self.wrong

    def as_dict(self) -> dict[str, Any]:
        """Describe the report as JSON values: `healthy`, `lines` and `stations`."""
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

    return _audit(stations, stations, instrument, models)


def _audit(
    stations: Sequence[AuditedStation],
    whole: Iterable[AuditedStation],
    instrument: Instrument,
    models: Callable[[], SkyModels] | None,
) -> AuditReport:
    """Audit stations, of which `whole` has all events, one at a time: dates are looked for in these."""
    lines: list[Line] = []
    with warnings.catch_warnings():
        # nothing recorded
        warnings.filterwarnings("ignore", "All-NaN|Mean of empty|Degrees of freedom", RuntimeWarning)
        for station, of_all_events in zip(stations, whole, strict=True):
            lines += [*find_empty_channels(station), *find_copies(station)]
            moved = find_moved(of_all_events)
            own = _audit_station(put_in_place(station, moved), instrument.at_station(station.name), models)
            lines += own if any(map(_is_no_power, own)) else [*own, *moved]
    return AuditReport(lines, stations)


def _audit_station(
    station: AuditedStation, instrument: Instrument, models: Callable[[], SkyModels] | None
) -> list[Line]:
    if station.antennas.size < FEWEST:
        everyone = np.arange(station.antennas.size)
        sentence = f"paths and cables are compared in {FEWEST} antennas or more, here are {everyone.size}"
        alone = [Line("antennas", UNDECIDED, station.name, sentence), *find_steps(station, everyone)]
        if models is None or len(alone) > 1:
            return alone
        return [*alone, *_ask_sky(SkyMatch(station, instrument, models), np.ones(everyone.size, dtype=bool))]
    as_recorded = compare_paths(station)
    is_off = find_ill_paths(station, as_recorded)[1].any(axis=1)
    working = np.flatnonzero(~is_off)
    of_unit = tell_unit(station, working, instrument)
    if any(map(_is_no_power, of_unit)):
        return of_unit  # what else would be compared is no power
    steps = find_steps(station, working)
    wrong_cables, found = find_wrong_cables(station, as_recorded, instrument)
    station = station.with_cables(found, instrument)
    comparison = compare_paths(station)
    ill, is_ill = find_ill_paths(station, comparison)
    is_usable = np.asarray(~is_ill.any(axis=1) & np.isfinite(comparison.level).all(axis=1))
    if models is None or any(line.check == STEPPED for line in steps):
        # a series of two chains is no series of the sky
        exchanged = tell_exchanged(station, compare_polarisations(station, is_usable))
        return [*of_unit, *steps, *ill, *wrong_cables, *exchanged]
    asked = _ask_sky(SkyMatch(station, instrument, models), is_usable)
    if any(map(_is_no_power, asked)):
        return asked
    return [*steps, *ill, *wrong_cables, *asked]


def _is_no_power(line: Line) -> bool:
    return line.check == "unit" and line.verdict == WRONG


def _ask_sky(match: SkyMatch, is_usable: NDArray[np.bool_]) -> list[Line]:
    """Which antennas are exchanged against the sky, and what it says of those that are not."""
    exchange = compare_polarisations(match.station, is_usable)
    most, others = np.setdiff1d(exchange.rows, exchange.exchanged()), exchange.exchanged()
    if others.size and match.gain_of_exchange(most) > match.gain_of_exchange(others):
        exchange, most = exchange.flipped(), others
    of_sky = match.tell(most)
    if any(map(_is_no_power, of_sky)):
        return of_sky
    return [*tell_exchanged(match.station, exchange), *of_sky]


# The part of an audit that needs no model of the sky: what comes before a fit or an investigation.
#
# It compares antennas with each other in a hundred events or so, whatever the length of the data: paths that do not
# work, cables, exchanged letters, and the unit, as far as cables tell it.

EVENTS = 100
"""Events of a station that are compared, evenly spread over all."""
FEWEST_CHANNELS = 5
"""Channels below which a chain along frequency cannot be fitted."""
SHOWN = 4
"""Lines that are told; more are counted."""


@dataclass(frozen=True)
class QuickAudit:
    """The result of the part of the audit that needs no sky.

    Attributes
    ----------
    report
        Without stations where none has antennas enough to be compared.
    """

    report: AuditReport

    @property
    def sentence(self) -> str:
        """One sentence for the provenance."""
        if not self.report.stations:
            return f"none: no station has {FEWEST} antennas to compare; `lbacal audit` asks the sky"
        wrong = self.report.wrong
        antennas = sum(station.antennas.size for station in self.report.stations)
        if not wrong:
            of_unit = [line for line in self.report.lines if line.check == "unit"]
            checks = f"paths, cables, letters of single antennas, steps{'' if of_unit else ', unit'}"
            doubts = "".join(f"; {line.station}: {line.sentence}" for line in of_unit if (line.log_odds or 0.0) > ALIKE)
            return f"nothing wrong between {antennas} antennas ({checks}){doubts}"
        told = "; ".join(f"{line.station}: {line.sentence}" for line in wrong[:SHOWN])
        more = f"; and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
        return f"{len(wrong)} wrong in {antennas} antennas (lbacal audit tells more): {told}{more}"

    def mark(self, report: FitReport) -> FitReport:
        """The report of a fit of these spectra: what the audit says, and no good curve where the power stepped.

        Where the fit names a mistake, antennas that agree with each other are no contradiction, and nothing is said.
        """
        stepped = {line.station for line in self.report.wrong if line.check == STEPPED}
        curves = [
            curve.as_misfit() if curve.c is not None and stepped and curve.station in {None, *stepped} else curve
            for curve in report.curves
        ]
        says = self.report.wrong or LIKELY_MISTAKE not in report.provenance.notes
        provenance = report.provenance.with_note("audit", self.sentence) if says else report.provenance
        return replace(report, curves=tuple(curves), provenance=provenance)

    def require_power(self, origin: str) -> None:
        """Refuse spectra whose unit is not that of power: a fit of them says nothing."""
        wrong = [line for line in self.report.wrong if line.check == "unit"]
        if wrong:
            said = f"{wrong[0].station}: {wrong[0].sentence} (ln odds {wrong[0].log_odds:+.0f})"
            raise BadInputError(f"{origin}: power", "power per MHz on a linear scale", said)


def audit_quickly(spectra: Spectra, instrument: Instrument) -> QuickAudit:
    """Compare the antennas of every station that has enough of them, in some of their events."""
    if spectra.frequency_mhz.size < FEWEST_CHANNELS:
        expected = f"at least {FEWEST_CHANNELS} to fit a chain (lbacal audit compares antennas in one)"
        raise BadInputError(f"{spectra.origin}: channels", expected, str(spectra.frequency_mhz.size))
    of_stations = [_choose_rows(spectra, station) for station in np.unique(spectra.station)]
    chosen = np.concatenate([np.zeros(0, dtype=np.int64), *of_stations])
    if chosen.size == 0:
        return QuickAudit(AuditReport((), ()))
    stations = tuple(split_stations(spectra.select(np.sort(chosen)), instrument))
    compared = {one.name for one in stations}
    whole = (one for one in split_stations(spectra, instrument) if one.name in compared)
    return QuickAudit(_audit(stations, whole, instrument, None))


def _choose_rows(spectra: Spectra, station: str) -> NDArray[np.int64]:
    """Rows of some events of a station; none where it has too few antennas."""
    rows = np.flatnonzero(spectra.station == station)
    events, at, count = np.unique(spectra.event_id[rows], return_inverse=True, return_counts=True)
    full = np.flatnonzero(count >= np.median(count))
    time = np.full(events.size, np.inf)
    np.minimum.at(time, at, spectra.time_unix[rows])
    in_order = full[np.argsort(time[full])]
    taken = in_order[np.unique(np.linspace(0, in_order.size - 1, EVENTS).astype(int))]
    chosen = rows[np.isin(at, taken)]
    return chosen if np.unique(spectra.antenna[chosen]).size >= FEWEST else chosen[:0]
