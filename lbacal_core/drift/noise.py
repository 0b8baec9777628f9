"""The noise of monthly series: that of events, and what lasts longer than an event, estimated from all series.

The mean of n events has the variance 1/n in units of the event noise. Weather, read-out and whatever nobody models add
a process that lasts: rho exp(-|dt| / L). Its level and length are common to the series of one kind and one mode; the
likelihood over a grid of both decides (residual maximum likelihood: offset, season, slope and one step are
marginalised).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.drift.terms import OFFSET, SEASON_PRIOR, SLOPE
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric, solve_symmetric

LENGTHS_MONTHS = (0.3, 2.0, 8.0, 30.0)
LEVELS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Variance of the process over that of the mean of a typical month's events."""
MOST_SERIES = 150
"""As many series determine two numbers."""
NO_EVENTS = 1e-6
_FREE = 1e4


@dataclass(frozen=True)
class Lasting:
    """The process beside the events' noise: its variance in units of the event noise, and its length in months."""

    variance: float
    length_months: float

    def covariance(self, months: NDArray[np.datetime64]) -> Floats:
        """Shape (month, month)."""
        number = months.astype(np.int64)
        distance = np.abs(number[:, None] - number)
        return np.asarray(self.variance * np.exp(-distance / self.length_months))


def estimate_lasting(
    y: Floats, events: Floats, smooth: Floats, scale: Floats, months: NDArray[np.datetime64], more: Floats
) -> Lasting:
    """Estimate the process of one mode.

    Parameters
    ----------
    y
        Shape (series, month), in units of the event noise, 0 where unknown.
    events
        Shape (series, month).
    smooth
        Offset, season and slope at the months, shape (month, 6).
    scale
        The event noise, shape (series,).
    more
        One more column of each series that is no noise, shape (series, month); zeros where there is none.
    """
    if not np.any(events > 0):
        return Lasting(0.0, 1.0)
    some = slice(None, None, max(1, -(-len(y) // MOST_SERIES)))
    y, events, scale, more = y[some], events[some], scale[some], more[some]
    prior = np.full((len(y), smooth.shape[1]), _FREE)
    prior[:, OFFSET + 1 : SLOPE] = (np.array(SEASON_PRIOR) / scale[:, None]) ** 2
    fixed = (smooth * prior[:, None, :]) @ smooth.T + _FREE * more[:, :, None] * more[:, None, :]
    fixed[:, np.arange(len(months)), np.arange(len(months))] += 1.0 / np.maximum(events, NO_EVENTS)
    of_month = 1.0 / np.median(events[events > 0])
    grid = [Lasting(0.0, 1.0)]
    grid += [Lasting(level * of_month, length) for level in LEVELS[1:] for length in LENGTHS_MONTHS]
    return min(grid, key=lambda one: _minus_log_likelihood(fixed + one.covariance(months), y))


def _minus_log_likelihood(covariance: Floats, y: Floats) -> float:
    chi2 = np.sum(y * solve_symmetric(covariance, y[..., None])[..., 0])
    return float(chi2 + np.sum(np.linalg.slogdet(covariance)[1]))


def invert_covariance(events: Floats, lasting: Lasting, months: NDArray[np.datetime64]) -> Floats:
    """W of every series, shape (series, month, month): its rows are practically 0 where a month has no event."""
    covariance = np.repeat(lasting.covariance(months)[None], len(events), axis=0)
    diagonal = np.arange(len(months))
    covariance[:, diagonal, diagonal] += 1.0 / np.maximum(events, NO_EVENTS)
    return invert_symmetric(covariance)


def correlate_modes(y: Floats, events: Floats) -> Floats:
    """Correlation of the modes' noise, shape (mode, mode), from residuals in units of the event noise."""
    weighted = y * np.sqrt(events)
    product = np.einsum("ksm,lsm->kl", weighted, weighted)
    size = np.sqrt(np.diag(product))
    return np.asarray(product / np.maximum(np.outer(size, size), 1e-300) + 1e-6 * np.eye(len(y)))
