"""The date of a step, from events: months only say between which of them to look.

Given its size, a step at the date t changes the likelihood by the events between t and any other date. With a uniform
prior in time that is a probability of t, constant between two events: its median is the date, and the interval that
holds 95 % of it is stated beside its standard deviation. Where a path was silent, that interval is the gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats

REACH_S = 62 * 86_400.0
"""A step lies within so much of the month in which the scan saw it."""
OUTER = 0.025
"""Probability on either side of the stated interval."""


@dataclass(frozen=True)
class Dates:
    """When steps happened, s UTC, shape (step,) each: median, standard deviation, and the interval that holds 95 %."""

    date: Floats
    sigma: Floats
    earliest: Floats
    latest: Floats


def find_dates(time_unix: Floats, residual: Floats, size: Floats, near_unix: Floats) -> Dates:
    """Date some steps.

    Parameters
    ----------
    time_unix
        Shape (event,), rising.
    residual
        What is left of each event without the step, modes uncorrelated and of unit noise, shape (step, event, mode);
        NaN where unknown.
    size
        The steps in the same unit, shape (step, mode).
    near_unix
        About when they happened, shape (step,).
    """
    gain = np.einsum("sek,sk->se", residual, size) - 0.5 * np.sum(size**2, axis=1)[:, None]
    width = np.diff(time_unix)
    is_gap = (time_unix[1:] >= near_unix[:, None] - REACH_S) & (time_unix[:-1] <= near_unix[:, None] + REACH_S)
    is_gap &= width > 0
    is_near = np.pad(is_gap, ((0, 0), (0, 1))) | np.pad(is_gap, ((0, 0), (1, 0)))
    gain = np.where(is_near & np.isfinite(gain), gain, 0.0)
    after = np.cumsum(gain[:, ::-1], axis=1)[:, ::-1][:, 1:]  # of all events behind the gap that follows an event
    log_p = np.where(is_gap, after + np.log(np.maximum(width, 1e-9)), -np.inf)
    p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    middle = 0.5 * (time_unix[1:] + time_unix[:-1])
    mean = p @ middle
    variance = np.sum(p * ((middle - mean[:, None]) ** 2 + width**2 / 12.0), axis=1)
    total = np.cumsum(p, axis=1)
    quantiles = [_quantile(total, p, time_unix, q) for q in (0.5, OUTER, 1.0 - OUTER)]
    return Dates(quantiles[0], np.sqrt(variance), quantiles[1], quantiles[2])


def _quantile(total: Floats, p: Floats, time_unix: Floats, q: float) -> Floats:
    gap = np.argmax(total >= min(q, 1.0 - 1e-12), axis=1)
    rows = np.arange(len(p))
    passed = 1.0 - (total[rows, gap] - q) / np.maximum(p[rows, gap], 1e-300)
    return np.asarray(time_unix[gap] + np.clip(passed, 0.0, 1.0) * (time_unix[gap + 1] - time_unix[gap]))
