"""The mean of a path's events in a month: one gain and two modes along frequency, against a fixed calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.drift.events import EventModes
from lbacal_core.grids import Floats

MIN_EVENTS = 5
"""Fewer events in a month leave its gain worse than 2.5 %."""


@dataclass(frozen=True)
class MonthlyRatios:
    """C of each month over that of the reference.

    Attributes
    ----------
    antennas
        Shape (antenna,), those with a reference.
    months
        Shape (month,), datetime64[M], rising.
    c_ratio, c_ratio_sigma
        Shape (antenna, month); NaN where a month has too few events.
    shape, shape_sigma
        Tilt and curvature of ln C, shape (antenna, month, 2); NaN where a month has too few events.
    events
        Shape (antenna, month).
    """

    antennas: NDArray[np.int64]
    months: NDArray[np.datetime64]
    c_ratio: Floats
    c_ratio_sigma: Floats
    shape: Floats
    shape_sigma: Floats
    events: NDArray[np.int64]


def average_months(modes: EventModes) -> MonthlyRatios:
    """Average the events of every month.

    The error of a month is the scatter of its path's events over the whole block divided by the root of their number:
    a month has too few events to know its own scatter.
    """
    months, starts = find_months(modes.time_unix)
    is_known = np.isfinite(modes.ln_c[..., 0])
    values = modes.ln_c.copy()
    values[..., 0] = np.exp(-2.0 * values[..., 0])  # the power gain, whose mean is C^-2
    values[~is_known] = 0.0
    events = np.add.reduceat(is_known.astype(np.int64), starts, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.add.reduceat(values, starts, axis=1) / events[..., None]
        squares = np.add.reduceat(values**2, starts, axis=1) - events[..., None] * mean**2
        freedom = np.maximum(is_known.sum(axis=1) - (events > 0).sum(axis=1), 1)
        scatter = np.sqrt(np.maximum(np.nansum(squares, axis=1), 0.0) / freedom[:, None])
        sigma = scatter[:, None, :] / np.sqrt(events)[..., None]
        is_good = (events >= MIN_EVENTS) & (mean[..., 0] > 0)
        mean[~is_good] = sigma[~is_good] = np.nan
        c_ratio, c_ratio_sigma = mean[..., 0] ** -0.5, 0.5 * sigma[..., 0] * mean[..., 0] ** -1.5
    return MonthlyRatios(modes.antennas, months, c_ratio, c_ratio_sigma, mean[..., 1:], sigma[..., 1:], events)


def find_months(time_unix: Floats) -> tuple[NDArray[np.datetime64], NDArray[np.int64]]:
    """The months with events, and the first event of each: shape (month,) both.

    Parameters
    ----------
    time_unix
        Shape (event,), rising.
    """
    months, starts = np.unique(time_unix.astype("datetime64[s]").astype("datetime64[M]"), return_index=True)
    return months, starts
