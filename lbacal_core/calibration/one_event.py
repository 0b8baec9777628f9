"""How far the calibration of one event is from that of the mean: the gain that fluctuates from event to event.

C is that of the mean of many events. In a single event the power of an antenna is higher or lower by a few per cent in
all channels, by temperature, wetness and what else changes, and C^2 goes with its inverse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from lbacal_core.curves.curves import OK, CalibrationCurve, FitReport
from lbacal_core.grids import WITHIN_1_SIGMA, Floats
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import SpectraBlock, iterate_blocks
from lbacal_core.spectra.spectra import Spectra

# What events depart from the curve that answers for their path: its own, else that of its station or of the array.

LST_BINS = 48


def compare_paths(
    block: SpectraBlock, curves: Iterable[CalibrationCurve], simulation: Simulation
) -> Iterator[tuple[int, CalibrationCurve, Floats]]:
    """Measured over predicted power of every path of a block that a curve answers for.

    Returns
    -------
    The row of the path in the block, its curve, and the ratio, shape (event that the path has, freq).
    """
    known = {curve.path: curve for curve in curves if curve.c is not None}
    sky = simulation.sky_at(block.station, block.dipole, block.time_unix)
    for row, antenna in enumerate(block.antennas.tolist()):
        owners = ((block.station, antenna), (block.station, None), (None, None))
        curve = next((known[(*owner, block.dipole)] for owner in owners if (*owner, block.dipole) in known), None)
        is_present = block.is_present[row]
        if curve is not None and np.any(is_present):
            yield row, curve, block.power[row, is_present] / simulation.power(curve, sky[is_present])


def map_departures(block: SpectraBlock, curves: Iterable[CalibrationCurve], simulation: Simulation) -> Floats:
    """Measured over predicted power minus 1, the mean over a station's antennas and the events of each LST bin.

    A path without a curve of its own counts less its mean departure in each channel, which is its own gain.

    Returns
    -------
    Shape (LST_BINS, freq); NaN in a bin without events.
    """
    lst_hours = simulation.sidereal_time(block.station, block.time_unix)
    bins = np.minimum((lst_hours / 24.0 * LST_BINS).astype(int), LST_BINS - 1)
    total = np.zeros((LST_BINS, block.frequency_mhz.size))
    count = np.zeros((LST_BINS, 1))
    for row, curve, ratio in compare_paths(block, curves, simulation):
        own = ratio if curve.antenna is not None else ratio / ratio.mean(axis=0)
        at = bins[block.is_present[row]]
        np.add.at(total, at, own - 1.0)
        np.add.at(count, at, 1.0)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)


@dataclass(frozen=True)
class OverLst:
    """Band power of a path against sidereal time, relative to its predicted mean over the day.

    Attributes
    ----------
    lst_hours
        Middles of the bins that have events, shape (bin,).
    measured, error
        Mean of the events of a bin and its standard error, shape (bin,); NaN for the error of a single event.
    expected
        What the fitted curve predicts at those sidereal times, shape (bin,).
    """

    lst_hours: Floats
    measured: Floats
    error: Floats
    expected: Floats


def compare_over_lst(spectra: Spectra, curve: CalibrationCurve, simulation: Simulation) -> OverLst:
    """Mean power over the good channels of one path against sidereal time, measured and as its curve predicts it."""
    good = curve.has_value & (curve.flags == OK)
    lst_hours = simulation.sidereal_time(curve.station, spectra.time_unix)
    day = simulation.background(curve, np.arange(LST_BINS) * 24.0 / LST_BINS)[:, good].mean(axis=1)
    place = np.minimum((lst_hours / 24.0 * LST_BINS).astype(int), LST_BINS - 1)
    power = spectra.power[:, good].mean(axis=1) / day.mean()
    count = np.bincount(place, minlength=LST_BINS)
    known = np.flatnonzero(count)
    mean, square = (np.bincount(place, values, LST_BINS)[known] / count[known] for values in (power, power**2))
    scatter = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(count[known] - 1, 1))
    middle = (known + 0.5) * 24.0 / LST_BINS
    expected = simulation.background(curve, middle)[:, good].mean(axis=1) / day.mean()
    return OverLst(middle, mean, np.where(count[known] > 1, scatter, np.nan), expected)


FEWEST_EVENTS = 20


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


def measure_error(report: FitReport, spectra: Spectra, simulation: Simulation) -> ErrorOfC | None:
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
    gains = list(measure_event_gains(fitted, spectra, simulation).values())
    typical = {name: float(np.median(np.concatenate(values))) if values else 0.0 for name, values in relative.items()}
    return ErrorOfC(
        statistical=typical["c_sigma_stat"],
        systematic=typical["c_sigma_sys"],
        antenna=float(np.median(spreads)) if spreads else 0.0,
        event=0.5 * float(np.nanmedian(gains)) if gains else np.nan,
    )


def measure_event_gains(
    curves: Iterable[CalibrationCurve], spectra: Spectra, simulation: Simulation
) -> dict[tuple[str, int, str], float]:
    """Standard deviation of ln of the recorded power of each path from event to event, without radiometer noise.

    It is that of the mean over the good channels of measured over predicted power, each channel over its mean of the
    events. The noise that channels have by themselves is taken out by their scatter within an event.
    """
    fitted = list(curves)
    found = {}
    for block in iterate_blocks(spectra):
        for row, curve, ratio in compare_paths(block, fitted, simulation):
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
