"""The terms that series have now, and what follows from them: medians, monthly means, noise, fit, scores and dates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.drift.dates import find_dates
from lbacal_core.drift.medians import median_of_members, median_over
from lbacal_core.drift.monthly import find_months
from lbacal_core.drift.noise import Lasting, correlate_modes, estimate_lasting, invert_covariance
from lbacal_core.drift.scores import chi_square, find_threshold, score_slope, score_steps
from lbacal_core.drift.terms import SLOPE, STEPS, Fit, Terms, fit_terms, month_columns, smooth_columns
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener

MOST_STEPS = 8
FEWEST_EVENTS = 10
"""Events on either side of a step."""
NOISE_ROUNDS = 4
"""Fits, the first among them, after which the noise is known well enough."""
SMALLEST_NOISE = 1e-4
"""Noise of one event, in ln C: exact data, or none, keep a finite weight."""


@dataclass(frozen=True)
class Series:
    """Series of one kind, and the median of each group.

    Attributes
    ----------
    values
        Shape (series, event, mode), NaN where unknown.
    group
        Shape (series,), to which group each belongs.
    time_unix
        Shape (event,), rising.
    """

    values: NDArray[np.float32]
    group: NDArray[np.int64]
    time_unix: Floats


class SeriesModel:
    """The terms that series have now, and what follows from them.

    Attributes
    ----------
    terms
        Slopes and steps.
    errors
        Standard deviation of each date, and both ends of the interval that holds 95 %, shape (3, series, step).
    median
        Shape (group, event, mode).
    scale
        Noise of one event, shape (mode, series).
    lasting
        The process beside it, for each mode.
    result
        The fit of all series.
    cut
        The chi-square that something found exceeds.
    """

    def __init__(self, series: Series, known_unix: Floats | None, false_alarms: float) -> None:
        self.series = series
        count, events, modes = series.values.shape
        known = np.full((count, 0), np.inf) if known_unix is None else known_unix
        dates = np.pad(known, ((0, 0), (0, MOST_STEPS)), constant_values=np.inf)
        self.terms = Terms(np.zeros(count, dtype=bool), dates, np.isfinite(dates))
        self.errors = np.full((3, *dates.shape), np.nan)
        self.months, self.starts = find_months(series.time_unix)
        middle = 0.5 * (series.time_unix[0] + series.time_unix[-1])
        self.smooth = smooth_columns(series.time_unix, middle)
        self.smooth_months = np.add.reduceat(self.smooth, self.starts, axis=0)
        self.smooth_months /= np.diff(np.append(self.starts, events))[:, None]
        level = np.nan_to_num(median_over(series.values, axis=1))
        self.model = np.repeat(level[:, None, :], events, axis=1)
        self.median = np.zeros((int(series.group.max()) + 1, events, modes), dtype=np.float32)
        self.is_new = np.ones(len(self.median), dtype=bool)
        self.cut = find_threshold(false_alarms, count * len(self.months), modes)
        self.lasting: tuple[Lasting, ...] = ()
        self.result: Fit
        self.rounds = 0
        self.all = np.arange(count)

    def fit(self) -> None:
        """Remove medians, average months, estimate the noise, and fit."""
        for g in np.flatnonzero(self.is_new):
            members = self.series.group == g
            self.median[g] = median_of_members(self.series.values[members] - self.model[members])
        self.rest = self.series.values - self.median[self.series.group]
        self.is_known = np.isfinite(self.rest[..., 0])
        known = self.is_known[..., None]
        off = np.where(known, self.rest - self.model, 0.0)
        self.events = np.add.reduceat(self.is_known.astype(float), self.starts, axis=1)
        total = np.maximum(self.is_known.sum(axis=1), 1)[:, None]
        self.scale = np.maximum(np.sqrt(np.sum(off**2, axis=1, dtype=float) / total), SMALLEST_NOISE).T
        mean = np.add.reduceat(np.where(known, self.rest, 0.0), self.starts, axis=1, dtype=float)
        mean /= np.maximum(self.events, 1.0)[..., None]
        self.y = np.moveaxis(mean, -1, 0) / self.scale[..., None]
        if self.rounds < NOISE_ROUNDS:
            self._estimate_noise()
        self.rounds += 1
        self.fit_terms(self.all)

    def _estimate_noise(self) -> None:
        """Estimate what lasts, from residuals without the best step of each series: a few series may all have one."""
        columns = self.columns(self.all)
        plain = invert_covariance(self.events, Lasting(0.0, 1.0), self.months)[None]
        self.inverse = np.repeat(plain, len(self.y), axis=0)
        self.result = fit_terms(self.y, self.inverse, columns, self.scale)
        left = self.y - (columns @ self.result.theta[..., None])[..., 0]
        self.whitener = find_whitener(correlate_modes(left, self.events))
        steps, _ = self.scores(self.all)
        best = np.argmax(steps, axis=1)
        is_step = (np.arange(len(self.months)) >= best[:, None]) & (steps[self.all, best] > self.cut)[:, None]
        self.lasting = tuple(
            estimate_lasting(y, self.events, self.smooth_months, scale, self.months, is_step.astype(float))
            for y, scale in zip(left, self.scale, strict=True)
        )
        self.inverse = np.stack([invert_covariance(self.events, one, self.months) for one in self.lasting])

    def columns(self, rows: NDArray[np.int64]) -> Floats:
        """The columns of some series, shape (series, month, column)."""
        terms = Terms(self.terms.has_slope[rows], self.terms.dates[rows], self.terms.is_known[rows])
        return month_columns(self.smooth_months, terms, self.series.time_unix, self.is_known[rows], self.starts)

    def fit_terms(self, rows: NDArray[np.int64]) -> None:
        """Fit some series, and keep their results and what their model predicts of every event."""
        fit = fit_terms(self.y[:, rows], self.inverse[:, rows], self.columns(rows), self.scale[:, rows])
        if rows.size == self.all.size:
            self.result = fit
        else:
            for name in ("theta", "covariance", "weighted_residual"):
                getattr(self.result, name)[:, rows] = getattr(fit, name)
        theta = fit.theta * self.scale[:, rows, None]
        model = np.moveaxis(theta[:, :, :STEPS] @ self.smooth.T, 0, -1)
        for j in range(self.terms.dates.shape[1]):
            used = np.flatnonzero(np.isfinite(self.terms.dates[rows, j]))
            is_after = self.series.time_unix >= self.terms.dates[rows[used], j, None]
            model[used] += is_after[..., None] * theta[:, used, STEPS + j].T[:, None, :]
        self.model[rows] = model

    def scores(self, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Chi-square of a step before every month, shape (series, month), and of a slope, shape (series,)."""
        fit = Fit(self.result.theta[:, rows], self.result.covariance[:, rows], self.result.weighted_residual[:, rows])
        inverse, columns = self.inverse[:, rows], self.columns(rows)
        steps = score_steps(inverse, columns, fit, self.whitener)
        slopes = score_slope(inverse, columns, fit, self.whitener, self.smooth_months[:, SLOPE])
        steps = np.where(self._may_step(rows), steps, 0.0)
        return steps, np.where(self.terms.has_slope[rows], 0.0, slopes)

    def _may_step(self, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Where a step is possible: enough events on either side, no other step in the month, and room for it."""
        events, dates = self.events[rows], self.terms.dates[rows]
        before = np.cumsum(events, axis=1) - events
        may = (before >= FEWEST_EVENTS) & (events.sum(axis=1, keepdims=True) - before >= FEWEST_EVENTS)
        taken = np.searchsorted(self.series.time_unix[self.starts], dates, side="right") - 1
        for j in range(taken.shape[1]):
            used = np.flatnonzero(np.isfinite(dates[:, j]))
            may[used, np.maximum(taken[used, j], 0)] = False
        return np.asarray(may & np.any(np.isinf(dates), axis=1, keepdims=True))

    def own_chi2(self) -> tuple[Floats, Floats]:
        """Chi-square of the terms in the model: steps, shape (series, step), and slopes."""
        variance = np.diagonal(self.result.covariance, axis1=2, axis2=3)
        chi2 = chi_square(self.whitener, self.result.theta, variance)
        steps = np.where(np.isfinite(self.terms.dates), chi2[:, STEPS:], 0.0)
        return steps, np.where(self.terms.has_slope, chi2[:, SLOPE], 0.0)

    def remove(self, steps: NDArray[np.bool_], slopes: NDArray[np.bool_]) -> None:
        """Take steps, shape (series, step), and slopes, shape (series,), out of the terms."""
        dates = np.where(steps, np.inf, self.terms.dates)
        self.terms = replace(self.terms, has_slope=self.terms.has_slope & ~slopes, dates=dates)
        self.errors[:, steps] = np.nan

    def restore(self, terms: Terms, errors: Floats, rows: NDArray[np.int64]) -> None:
        """Give series the terms that they had, with the errors of their dates."""
        dates, has_slope = self.terms.dates.copy(), self.terms.has_slope.copy()
        dates[rows], has_slope[rows] = terms.dates[rows], terms.has_slope[rows]
        self.errors[:, rows] = errors[:, rows]
        self.terms = replace(self.terms, dates=dates, has_slope=has_slope)

    def put_steps(self, rows: NDArray[np.int64], month: NDArray[np.int64]) -> None:
        """Give series a step before a month each, and date it from events."""
        if rows.size == 0:
            return
        step = np.argmax(np.isinf(self.terms.dates), axis=1)[rows]
        self._set_dates(rows, step, self.series.time_unix[self.starts[month]])
        for _ in range(2):
            self.fit_terms(rows)
            size = self.result.theta[:, rows, STEPS + step].T
            near = self.terms.dates[rows, step]
            is_after = (self.series.time_unix >= near[:, None])[..., None]
            left = (self.rest[rows] - self.model[rows]) / self.scale.T[rows][:, None, :] + is_after * size[:, None]
            found = find_dates(self.series.time_unix, left @ self.whitener.T, size @ self.whitener.T, near)
            self._set_dates(rows, step, found.date)
            self.errors[:, rows, step] = found.sigma, found.earliest, found.latest

    def _set_dates(self, rows: NDArray[np.int64], step: NDArray[np.int64], dates: Floats) -> None:
        new = self.terms.dates.copy()
        new[rows, step] = dates
        self.terms = replace(self.terms, dates=new)

    def find_cost(self, rows: NDArray[np.int64]) -> Floats:
        """Chi-square of series, shape (series,), and the threshold for every term that they have."""
        chi2 = np.sum(self.y[:, rows] * self.result.weighted_residual[:, rows], axis=(0, 2))
        count = np.isfinite(self.terms.dates[rows]).sum(axis=1) + self.terms.has_slope[rows]
        return np.asarray(chi2 + self.cut * count)
