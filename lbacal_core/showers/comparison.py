"""What a wrong calibration does to the slopes of pulses: where it leaves the diagonal, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.showers.recording import Recording, field_power, true_power
from lbacal_core.showers.slopes import Slopes, fit_slopes

FEWEST_EVENTS = 3
"""Fewer leave the scatter of events unknown."""
MILLI = 1e3
"""Slopes are reported in 10^-3 per MHz."""


@dataclass(frozen=True)
class Displacement:
    """Where the signals of one calibration lie against the diagonal, in 10^-3 of log10(power) per MHz.

    Attributes
    ----------
    slopes
        Slopes of every signal.
    difference, difference_sigma
        Mean over events of the slope above minus the slope below the resonance, and its standard deviation from the
        scatter of the events: signals of one event share direction and calibration.
    low_shift, high_shift
        Median change of each slope against the true field's.
    """

    slopes: Slopes
    difference: float
    difference_sigma: float
    low_shift: float
    high_shift: float

    @property
    def significance(self) -> float:
        """Distance from the diagonal in its own standard deviations."""
        return self.difference / self.difference_sigma


def compare_calibrations(
    recording: Recording, channels_mhz: Floats, calibrations: Mapping[str, Floats], *, subtract: bool = True
) -> dict[str, Displacement]:
    """Slopes of the fields that each calibration makes of the same recorded pulses.

    Parameters
    ----------
    calibrations
        C of both dipoles by name, shape (2, freq) or (signal, 2, freq).
    subtract
        Whether the background of each event is subtracted.
    """
    bins = recording.signals.frequency_mhz
    truth = true_slopes(recording)
    found = {}
    for name, c in calibrations.items():
        slopes = fit_slopes(bins, *field_power(recording, c, channels_mhz, subtract=subtract))
        mean, sigma = _mean_over_events(recording, slopes)
        found[name] = Displacement(
            slopes,
            MILLI * mean,
            MILLI * sigma,
            MILLI * float(np.nanmedian(slopes.low - truth.low)),
            MILLI * float(np.nanmedian(slopes.high - truth.high)),
        )
    return found


def true_slopes(recording: Recording) -> Slopes:
    """Slopes of the pulses before they were recorded."""
    power = true_power(recording)
    return fit_slopes(recording.signals.frequency_mhz, power, np.zeros_like(power))


def _mean_over_events(recording: Recording, slopes: Slopes) -> tuple[float, float]:
    """Mean of high - low, each signal weighted by its error, and the error of the mean from jackknifing the events."""
    difference = slopes.high - slopes.low
    is_known = np.isfinite(difference)
    seen = np.unique(recording.signals.event[is_known]).size
    if seen < FEWEST_EVENTS:
        raise BadInputError("signals", f"{FEWEST_EVENTS} events or more above the background", f"{seen}")
    events, values = recording.signals.event[is_known], difference[is_known]
    weight = 1.0 / (slopes.low_sigma[is_known] ** 2 + slopes.high_sigma[is_known] ** 2)
    total, count = float(weight @ values), float(weight.sum())
    left_out = []
    for k in np.unique(events):
        own = events == k
        left_out.append((total - weight[own] @ values[own]) / (count - weight[own].sum()))
    size = len(left_out)
    return total / count, float(np.sqrt((size - 1) * np.var(left_out)))
