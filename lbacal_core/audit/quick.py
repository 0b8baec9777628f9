"""The part of an audit that needs no model of the sky: what comes before a fit or an investigation.

It compares antennas with each other in a hundred events or so, whatever the length of the data: paths that do not work,
cables, exchanged letters, and the unit, as far as cables tell it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.audit import AuditReport, audit_antennas
from lbacal_core.audit.finding import WRONG, Line
from lbacal_core.audit.station import FEWEST, split_stations
from lbacal_core.audit.steps import STEPPED
from lbacal_core.calibration.mistakes import LIKELY_MISTAKE
from lbacal_core.curves import FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument
from lbacal_core.spectra import Spectra

EVENTS = 100
"""Events of a station that are compared, evenly spread over all."""
FEWEST_CHANNELS = 5
"""Channels below which a chain along frequency cannot be fitted."""
SHOWN = 4
"""Lines that are told; more are counted."""


@dataclass(frozen=True)
class QuickAudit:
    """What the quick part says.

    Attributes
    ----------
    report
        None where no station has antennas enough to be compared.
    """

    report: AuditReport | None

    @property
    def sentence(self) -> str:
        """One sentence for the provenance."""
        if self.report is None:
            return f"none: no station has {FEWEST} antennas to compare"
        wrong = [line for line in self.report.lines if line.verdict == WRONG]
        antennas = sum(station.antennas.size for station in self.report.stations)
        if not wrong:
            return f"nothing wrong between {antennas} antennas (paths, cables, letters of single antennas, steps, unit)"
        told = "; ".join(f"{line.station}: {line.sentence}" for line in wrong[:SHOWN])
        more = f"; and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
        return f"{len(wrong)} wrong in {antennas} antennas (lbacal audit tells more): {told}{more}"

    def mark(self, report: FitReport) -> FitReport:
        """The report of a fit of these spectra: what the audit says, and no good curve where the power stepped.

        Where the fit names a mistake, antennas that agree with each other are no contradiction, and nothing is said.
        """
        lines = self.report.lines if self.report else ()
        wrong = [line for line in lines if line.verdict == WRONG]
        stepped = {line.station for line in wrong if line.check == STEPPED}
        curves = [
            curve.as_misfit() if curve.c is not None and stepped and curve.station in {None, *stepped} else curve
            for curve in report.curves
        ]
        says = wrong or LIKELY_MISTAKE not in report.provenance.notes
        provenance = report.provenance.with_note("audit", self.sentence) if says else report.provenance
        return replace(report, curves=tuple(curves), provenance=provenance)

    def require_power(self, origin: str) -> None:
        """Refuse spectra whose unit is not that of power: a fit of them says nothing."""
        units = [line for line in self.report.lines if line.check == "unit"] if self.report else []
        wrong: list[Line] = [line for line in units if line.verdict == WRONG]
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
        return QuickAudit(None)
    return QuickAudit(audit_antennas(tuple(split_stations(spectra.select(np.sort(chosen)), instrument)), instrument))


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
