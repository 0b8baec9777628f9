"""What a wrong calibration does to the slopes of pulses: where it leaves the diagonal, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm
from scipy.stats import t as student_t

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_paper.showers.recording import Recording, field_power, true_power
from lbacal_paper.showers.signals import Slopes, fit_slopes

FEWEST_EVENTS = 3
"""Fewer leave the scatter of events unknown."""
ONE_SIGMA = float(norm.cdf(1.0))
"""Probability below one standard deviation."""
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
        Mean over events of the slope above minus the slope below the resonance, and half of its 68 % interval from
        the scatter of the events (`mean_of_unequal`): signals of one event share direction and calibration.
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
    """Mean of high - low over events and its error; each signal of an event is weighted by its own error."""
    difference = slopes.high - slopes.low
    is_known = np.isfinite(difference)
    _, event = np.unique(recording.signals.event[is_known], return_inverse=True)
    if event.size == 0 or event.max() + 1 < FEWEST_EVENTS:
        seen = 0 if event.size == 0 else int(event.max()) + 1
        raise BadInputError("signals", f"{FEWEST_EVENTS} events or more above the background", f"{seen}")
    weight = 1.0 / (slopes.low_sigma[is_known] ** 2 + slopes.high_sigma[is_known] ** 2)
    total = np.bincount(event, weight)
    return mean_of_unequal(np.bincount(event, weight * difference[is_known]) / total, np.asarray(total**-0.5))


def mean_of_unequal(values: Floats, sigma: Floats) -> tuple[float, float]:
    """Mean of a few values of unequal error that may scatter by more than it, and half of the mean's 68 % interval.

    With weights w = 1/(sigma^2 + tau^2) the error of the mean is that of Hartung and Knapp (2001, Statistics in
    Medicine 20, 1771), sum w (y - mean)^2 / ((n - 1) sum w), whose pull follows Student's t with n - 1 degrees
    of freedom; tau, the scatter between values, is that of Paule and Mandel (1982, J. Res. NBS 87, 377). A jackknife
    has fewer degrees of freedom than it has values, because few of them have most of the weight: of 20 events whose
    signal over background spans a factor of 100 about eight, and it states the error a tenth too small.

    Parameters
    ----------
    values, sigma
        Shape (n,).
    """
    freedom = values.size - 1

    def chi2_beyond(scatter: float) -> float:
        """Chi^2 about the mean above its expectation, for a variance between values."""
        weight = 1.0 / (sigma**2 + scatter)
        return float(weight @ (values - weight @ values / weight.sum()) ** 2) - freedom

    scatter = 0.0 if chi2_beyond(0.0) <= 0.0 else brentq(chi2_beyond, 0.0, float(np.sum((values - values.mean()) ** 2)))
    weight = 1.0 / (sigma**2 + scatter)
    variance = (chi2_beyond(scatter) / freedom + 1.0) / weight.sum()
    return float(weight @ values / weight.sum()), float(student_t.ppf(ONE_SIGMA, freedom) * np.sqrt(variance))
