"""Gains that last: in a record of days they follow sidereal time by chance, and slopes are less certain than they seem.

Lines take the gains of events for independent. Where neighbours are alike (weather, read-out), some days do not average
what they share over the hours in which the sky rises. With the covariance m exp(-|dt| / L) of unit amounts beside that
of independent ones, the coefficient of the sky's course x gets x M x / (x x)^2 more of variance (least squares with the
weights of independent errors; Newey and West 1987, Econometrica 55, 703). The level of a window is the mean of its
gains, however long these last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S
from lbacal_core.linear import fit_least_squares
from lbacal_core.simulation.prior import SKY_HARMONICS
from lbacal_core.sky.table import DAY_HOURS, harmonics_at

CELLS = 8192
"""Cells of time: an hour of a year, half a minute of three days. Sums over pairs of events are convolutions of them."""
LAGS = CELLS // 3
"""Pairs further apart tell more of the mean of the window, which was taken off, than of memory."""
TRIED = 24
"""L that are tried, up to a sidereal day: what lasts longer is a step or a drift, over which the sky comes round."""
HAS_MEMORY = 5.0
"""Standard deviations beyond which neighbours are alike: by chance one of 3 million series."""


def find_variance_along(amount: Floats, course: Floats, time_unix: Floats) -> Floats:
    """Variance of the coefficients of a course beyond that of independent amounts, in units of theirs, shape (series,).

    0 where neighbouring events are not alike beyond chance. Waves of LST are no memory: they are the sky's.

    Parameters
    ----------
    amount
        Shape (series, event); NaN where absent.
    course, time_unix
        Shape (event,).
    """
    order = np.argsort(time_unix)
    since = time_unix[order] - time_unix[order[0]]
    cells = np.minimum(since / max(since[-1], 1.0) * CELLS, CELLS - 1.0).astype(int)
    waves = harmonics_at(time_unix[order] / SIDEREAL_DAY_S * DAY_HOURS % DAY_HOURS, SKY_HARMONICS)
    amount, course = amount[:, order], course[order]
    longest = np.clip(SIDEREAL_DAY_S / max(since[-1], 1.0) * CELLS, 4.0, LAGS)
    lasting = np.exp(-np.arange(LAGS) / np.geomspace(4.0, longest, TRIED)[:, None])
    found = np.zeros(len(amount))
    for k in np.flatnonzero(_has_memory(amount)).tolist():
        here = np.flatnonzero(np.isfinite(amount[k]))
        x, y, own, cell = course[here] - course[here].mean(), amount[k, here], waves[here], cells[here]
        y = y - own @ fit_least_squares(own, y)
        if not (np.any(x) and _has_memory(y)):
            continue
        pairs, alike, alike_in_x = (_sum_pairs(one, cell) for one in (np.ones(here.size), y / y.std(), x))
        norm = np.maximum(lasting**2 @ pairs, 1.0)
        size = np.maximum(lasting @ alike / norm, 0.0)
        best = int(np.argmax(size**2 * norm))
        if best == TRIED - 1 and longest < LAGS:
            continue
        found[k] = max(2.0 * size[best] * (lasting[best] @ alike_in_x), 0.0) / (x @ x) ** 2
    return found


def _has_memory(amount: Floats) -> NDArray[np.bool_]:
    """Whether neighbours in a series, shape (..., event), are alike beyond chance."""
    events = np.isfinite(amount).sum(axis=-1)
    mean = np.nansum(amount, axis=-1) / np.maximum(events, 1)
    beside = np.nan_to_num(amount - mean[..., None])
    alike, total = np.sum(beside[..., 1:] * beside[..., :-1], axis=-1), np.sum(beside**2, axis=-1)
    return np.asarray(alike * events**0.5 > HAS_MEMORY * total)


def _sum_pairs(values: Floats, cell: NDArray[np.int64]) -> Floats:
    """Products of the values of two events, summed over all pairs that are so many cells apart, shape (lag,)."""
    transformed = np.fft.rfft(np.bincount(cell, values, CELLS), 2 * CELLS)
    found = np.fft.irfft(np.abs(transformed) ** 2)[:LAGS]
    found[0] = 0.5 * (found[0] - values @ values)
    return np.asarray(found)


def add_variance(information: Floats, direction: Floats, variance: Floats) -> Floats:
    """Information matrices with the covariance wider along a direction (Sherman & Morrison 1950), shape kept.

    Parameters
    ----------
    information, direction, variance
        Shape (path, k, k), (path, k) and (path,).
    """
    along = np.einsum("pij,pj->pi", information, direction)
    share = variance / (1.0 + variance * np.sum(direction * along, axis=1))
    return np.asarray(information - share[:, None, None] * along[:, :, None] * along[:, None, :])
