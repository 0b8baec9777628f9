"""C that goes on changing: at a rate from a date on, or with the season, beside the mean that a fit gives.

A fit gives the mean of ln C over its events. Where C is known to follow the date, what is served at an instant is that
mean times exp(d(t) - <d>): d is the slow change of ln C, and <d> its mean from the first event of the fit to the last,
as if events lay evenly between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from lbacal_core.calibration.spreads import ServedCurve
from lbacal_core.grids import YEAR_S, Floats

POINTS = 365
"""Dates that stand for the events of a fit."""


@dataclass(frozen=True)
class SlowChange:
    """A ramp or a season of ln C.

    Attributes
    ----------
    is_season
        Whether it returns every year, largest at the date; else it begins at the date, and goes on by `size` a year.
    date_unix, date_sigma_s
        s UTC.
    size, sigma
        The amplitude, or the change a year, of ln C in the mean over the band; and its standard deviation.
    shape
        The Legendre coefficients 1 and 2 of the same over the band.
    """

    is_season: bool
    date_unix: float
    date_sigma_s: float
    size: float
    sigma: float
    shape: tuple[float, float]

    def depart(self, time_unix: float, span_unix: tuple[float, float], late_s: float = 0.0) -> float:
        """Where it stands beside its mean over a span, in units of `size`; of one that is late by some time."""
        along = self.follow(np.append(np.linspace(*span_unix, POINTS), time_unix) - late_s)
        return float(along[-1] - along[:-1].mean())

    def follow(self, time_unix: Floats) -> Floats:
        """Values at times, s UTC, same shape, in units of `size`: 0 before a ramp, and in the mean of a season."""
        years = (time_unix - self.date_unix) / YEAR_S
        return np.asarray(np.cos(2.0 * np.pi * years) if self.is_season else np.maximum(years, 0.0))


def spread_over_band(modes: Sequence[float], frequency_mhz: Floats) -> Floats:
    """A mean over the band, a tilt and a curvature (Legendre polynomials 0 to 2) along frequency, shape (freq,)."""
    low, high = frequency_mhz[[0, -1]]
    return np.asarray(legendre.legval((2.0 * frequency_mhz - low - high) / (high - low), modes))


def follow_slow_changes(
    served: ServedCurve, slow: Iterable[SlowChange], time_unix: float, window_unix: tuple[float, float]
) -> ServedCurve:
    """Carry a curve along the slow changes of its path to an instant.

    The error of each, in size and date, is one more systematic term of the curve.

    Parameters
    ----------
    time_unix
        When the data to be calibrated were taken, s UTC.
    window_unix
        The window of the fit, for a curve of which nobody kept the first and the last event.
    """
    for one in slow:
        curve, span = served.curve, served.curve.span_unix or window_unix
        moved, late = one.depart(time_unix, span), one.date_sigma_s
        of_date = (one.depart(time_unix, span, late) - one.depart(time_unix, span, -late)) / 2.0
        factor = np.exp(moved * spread_over_band((one.size, *one.shape), curve.frequency_mhz))
        error = float(np.hypot(one.sigma * moved, one.size * of_date))
        if curve.c is None or curve.c_sigma_stat is None:
            return served
        c, sys, covariance = curve.c * factor, curve.c_sigma_sys, curve.covariance
        carried = replace(
            curve, c=c, c_sigma_stat=curve.c_sigma_stat * factor,
            c_sigma_sys=None if sys is None else c * np.hypot(sys / curve.c, error),
            covariance=None if covariance is None else covariance.with_own(np.full_like(c, error)),
        )  # fmt: skip
        served = replace(
            served, curve=carried, factor=served.factor * factor, error=float(np.hypot(served.error, error))
        )
    return served
