"""How far the calibration of one event is from that of the mean: the gain that fluctuates from event to event.

C is that of the mean of many events. In a single event the power of an antenna is higher or lower by a few per cent in
all channels, by temperature, wetness and what else changes, and C^2 goes with its inverse.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lbacal_core.curves import OK, CalibrationCurve, FitReport
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import iterate_blocks
from lbacal_core.uncertainty.departures import compare_paths

FEWEST_EVENTS = 20
WITHIN_1_SIGMA = (15.87, 84.13)


@dataclass(frozen=True)
class ErrorOfC:
    """One standard deviation of ln C, the median over the good channels of all curves.

    Attributes
    ----------
    statistical, systematic
        That of the curve, which is the mean of its events and paths.
    antenna
        Departure of a single antenna from a curve of a station or of the array, each through its own cable; 0 for a
        curve of its own, NaN where too few paths could be fitted to know it.
    event
        One event against the mean: half of its gain's standard deviation in power; NaN with too few events.
    """

    statistical: float
    systematic: float
    antenna: float
    event: float

    @property
    def of_mean(self) -> float:
        """Error of C for the mean of the events."""
        return float(np.hypot(self.statistical, self.systematic))

    @property
    def of_one_event(self) -> float:
        """Error of C for one event on one antenna."""
        return float(np.linalg.norm([self.of_mean, self.antenna, self.event]))


def measure_error(report: FitReport, spectra: Spectra, instrument: Instrument, sky_power: SkyPower) -> ErrorOfC | None:
    """The error of C for the mean and for one event on one antenna; None where no curve has values."""
    fitted = [curve for curve in report.curves if curve.c is not None and np.any(curve.flags == OK)]
    if not fitted:
        return None
    relative = {
        name: [
            np.asarray(error / curve.c)[curve.flags == OK]
            for curve in fitted
            if (error := getattr(curve, name)) is not None
        ]
        for name in ("c_sigma_stat", "c_sigma_sys")
    }
    spreads = [
        np.nan
        if chain is None or chain.spreads is None
        else float(np.median(0.5 * np.sqrt(chain.spreads.all_paths.variance)))
        for curve, chain in zip(report.curves, report.chains, strict=True)
        if curve.c is not None and curve.antenna is None
    ]
    gains = list(measure_event_gains(fitted, spectra, instrument, sky_power).values())
    typical = {name: float(np.median(np.concatenate(values))) if values else 0.0 for name, values in relative.items()}
    return ErrorOfC(
        statistical=typical["c_sigma_stat"],
        systematic=typical["c_sigma_sys"],
        antenna=float(np.median(spreads)) if spreads else 0.0,
        event=0.5 * float(np.nanmedian(gains)) if gains else np.nan,
    )


def measure_event_gains(
    curves: Iterable[CalibrationCurve], spectra: Spectra, instrument: Instrument, sky_power: SkyPower
) -> dict[tuple[str, int, str], float]:
    """Standard deviation of ln of the recorded power of each path from event to event, without radiometer noise.

    It is that of the mean over the good channels of measured over predicted power, each channel over its mean of the
    events. The noise that channels have by themselves is taken out by their scatter within an event.
    """
    fitted = list(curves)
    found = {}
    for block in iterate_blocks(spectra):
        for row, curve, ratio in compare_paths(block, fitted, instrument, sky_power):
            good = curve.flags == OK
            if ratio.shape[0] >= FEWEST_EVENTS and np.any(good):
                name = (block.station, int(block.antennas[row]), block.dipole)
                found[name] = _spread_of_events(ratio[:, good])
    return found


def _spread_of_events(ratio: Floats) -> float:
    """Standard deviation from event to event of a ratio of shape (event, channel), without the noise of channels."""
    ratio = ratio / ratio.mean(axis=0)
    low, high = np.percentile(ratio.mean(axis=1), WITHIN_1_SIGMA)
    within = float(np.median(ratio.var(axis=1, ddof=1))) / ratio.shape[1] if ratio.shape[1] > 1 else 0.0
    return float(np.sqrt(max(((high - low) / 2.0) ** 2 - within, 0.0)))
