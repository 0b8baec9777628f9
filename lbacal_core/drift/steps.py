"""Steps in monthly series: for each series the one date at which a jump explains it best, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

MIN_MONTHS = 2
"""Months needed on either side of a step."""


@dataclass(frozen=True)
class Steps:
    """The best step of each series; NaN where a series is too short.

    Attributes
    ----------
    month
        Shape (series,), index of the month in which the step happens.
    passed
        Shape (series,), fraction of that month that had passed before the step, 0 to 1.
    size, sigma
        Shape (series,), change of the series from before to after, and its standard deviation.
    """

    month: NDArray[np.int64]
    passed: Floats
    size: Floats
    sigma: Floats

    @property
    def significance(self) -> Floats:
        """|size| / sigma, shape (series,): that of the best of all months, no correction for having looked at all."""
        return np.asarray(np.abs(self.size) / self.sigma)


def find_steps(values: Floats, sigmas: Floats) -> Steps:
    """Find the most significant step of each series.

    The month of the step belongs to neither side: events before and after it share the month, and the mean of the
    month gives the proportion.

    Parameters
    ----------
    values, sigmas
        Shape (series, month); NaN where there is no value.
    """
    is_good = np.isfinite(values) & np.isfinite(sigmas)
    weight = np.where(is_good, 1.0 / np.where(is_good, sigmas, 1.0) ** 2, 0.0)
    weighted = weight * np.where(is_good, values, 0.0)
    before_w, after_w = _sums_around(weight)
    before_n, after_n = _sums_around(is_good.astype(float))
    before_s, after_s = _sums_around(weighted)
    is_possible = (before_n >= MIN_MONTHS) & (after_n >= MIN_MONTHS)
    with np.errstate(invalid="ignore", divide="ignore"):
        before, after = before_s / before_w, after_s / after_w
        size = np.where(is_possible, after - before, np.nan)
        sigma = np.where(is_possible, np.sqrt(1.0 / before_w + 1.0 / after_w), np.nan)
        significance = np.where(is_possible, np.abs(size) / sigma, -1.0)
        passed = np.where(is_good, 1.0 - (values - before) / size, 0.5)
    best = np.argmax(significance, axis=1)
    at = (np.arange(values.shape[0]), best)
    return Steps(best, np.clip(passed[at], 0.0, 1.0), size[at], sigma[at])


def _sums_around(values: Floats) -> tuple[Floats, Floats]:
    """Sums over the months before and over those after each month, shape (series, month)."""
    total = np.cumsum(values, axis=1)
    return total - values, total[:, -1:] - total
