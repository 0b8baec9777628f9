"""The terms that series have now, and what follows from them: medians, monthly means, noise, fit, scores and dates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.data.tables import read_prior
from lbacal_core.drift.events import find_months
from lbacal_core.grids import YEAR_S, Floats
from lbacal_core.linear import find_whitener, invert_symmetric, minus_log_likelihood
from lbacal_core.spectra.screening import median_over

# The linear model of a monthly series: an offset, a season, a slope and steps, fitted to many series at once.
#
# Least squares with the inverse covariance W of the months, in units of the event noise of the series:
# theta = (Z^T W Z + Q)^-1 Z^T W y, where Q holds the inverse variances of what is known beforehand of the season. An
# annual term that nobody models drives every detector of steps from 5 % to 30-80 % false alarms in seven years.

SEASON_PRIOR = read_prior()["season"].sizes
"""Standard deviations of ln C of the annual term (cosine, sine) and of the half-annual one, before any data: in a
series that is shorter than a year they keep the season from describing a step."""
OFFSET, SLOPE, STEPS = 0, 5, 6
"""Columns: the offset, four of the season, the slope, then the steps."""
_UNUSED = 1.0
_HARDLY_KNOWN = 1e-9


@dataclass(frozen=True)
class Terms:
    """Which terms the series have.

    Attributes
    ----------
    has_slope
        Shape (series,).
    dates
        Shape (series, step), s UTC; infinite where there is no step.
    is_known
        Shape (series, step): steps at which hardware changed, which stay in the model whatever their size.
    """

    has_slope: NDArray[np.bool_]
    dates: Floats
    is_known: NDArray[np.bool_]


@dataclass(frozen=True)
class Fit:
    """Coefficients in units of the event noise.

    Attributes
    ----------
    theta
        Shape (mode, series, column).
    covariance
        Shape (mode, series, column, column).
    weighted_residual
        W (y - Z theta), shape (mode, series, month).
    """

    theta: Floats
    covariance: Floats
    weighted_residual: Floats


def smooth_columns(time_unix: Floats, middle_unix: float) -> Floats:
    """Offset, season and slope (per year) at some times, shape (time, 6)."""
    years = (time_unix - middle_unix) / YEAR_S
    angle = 2 * np.pi * time_unix / YEAR_S
    season = [np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
    return np.stack([np.ones_like(years), *season, years], axis=-1)


def month_columns(
    smooth: Floats, terms: Terms, time_unix: Floats, is_known: NDArray[np.bool_], starts: NDArray[np.int64]
) -> Floats:
    """All columns at the months of every series, shape (series, month, column).

    A step within a month has there the part of the series' events that come after it.

    Parameters
    ----------
    smooth
        Shape (month, 6).
    time_unix
        Shape (event,), rising.
    is_known
        Whether a series has a value at an event, shape (series, event).
    starts
        Number of the first event of each month, shape (month,), as `drift.events.find_months` gives it.
    """
    series, steps = terms.dates.shape
    columns = np.zeros((series, len(smooth), STEPS + steps))
    columns[:, :, :STEPS] = smooth
    columns[~terms.has_slope, :, SLOPE] = 0.0
    for j in range(steps):
        used = np.flatnonzero(np.isfinite(terms.dates[:, j]))
        is_after = time_unix >= terms.dates[used, j, None]
        after = np.add.reduceat((is_known[used] & is_after).astype(float), starts, axis=1)
        events = np.add.reduceat(is_known[used].astype(float), starts, axis=1)
        columns[used, :, STEPS + j] = np.where(events > 0, after / np.maximum(events, 1.0), is_after[:, starts])
    return columns


def fit_terms(y: Floats, inverse: Floats, columns: Floats, scale: Floats) -> Fit:
    """Fit all series.

    Parameters
    ----------
    y
        Shape (mode, series, month), in units of the event noise; 0 where unknown.
    inverse
        W, shape (mode, series, month, month).
    columns
        Shape (series, month, column); a column of zeros is a term that the series does not have.
    scale
        The event noise, shape (mode, series).
    """
    weighted = inverse @ columns
    normal = np.swapaxes(columns, -1, -2) @ weighted
    is_used = np.any(columns != 0.0, axis=1)
    precision = np.where(is_used, _HARDLY_KNOWN, _UNUSED) * np.ones((*scale.shape, 1))
    precision[:, :, OFFSET + 1 : SLOPE] = (scale[..., None] / np.array(SEASON_PRIOR)) ** 2
    normal += precision[..., None] * np.eye(columns.shape[-1])
    covariance = invert_symmetric(normal)
    theta = (covariance @ (np.swapaxes(weighted, -1, -2) @ y[..., None]))[..., 0]
    residual = y - (columns @ theta[..., None])[..., 0]
    return Fit(theta, covariance, np.asarray((inverse @ residual[..., None])[..., 0]))


# How much a step at any month, or a slope, would explain beside the terms that series have: score tests.
#
# For a candidate column h the residual r of the fit gives the size (h W r) / (h W h - b^T S b), with b = Z^T W h and S
# the covariance of the fit: what the fit describes of h is profiled out. A step's column is 1 from its month on, so
# that all its products are sums over the end of a series, and all months are scored at once.

_NOTHING = 1e-12
_SMALLEST_P = 1e-250


def profile_steps(inverse: Floats, columns: Floats, fit: Fit) -> tuple[Floats, Floats]:
    """Scores and information of steps before every month, shapes (mode, series, month) and (..., month, month).

    What the fit describes is profiled out; arguments as in `fit_terms`.
    """
    after = np.cumsum((inverse @ columns)[:, :, ::-1], axis=2)[:, :, ::-1]
    sums = np.cumsum(np.cumsum(inverse[:, :, ::-1, ::-1], axis=2), axis=3)[:, :, ::-1, ::-1]
    score = np.cumsum(fit.weighted_residual[:, :, ::-1], axis=2)[:, :, ::-1]
    return score, sums - (after @ fit.covariance) @ np.swapaxes(after, 2, 3)


def score_steps(score: Floats, information: Floats, whitener: Floats) -> Floats:
    """Chi-square of a step before every month or amid its events, the larger of both, shape (series, month).

    A season describes much of a step between months, and in a year nearly as much as a slope does: a step in August was
    one in December. Arguments as `profile_steps` has them.
    """
    own = np.maximum(np.diagonal(information, axis1=2, axis2=3), _NOTHING)
    last = [(0, 0), (0, 0), (0, 1)]  # a step behind all events is none
    beside = np.pad(np.diagonal(information, 1, axis1=2, axis2=3), last)
    amid = np.maximum((own + 2.0 * beside + np.pad(own[..., 1:], last)) / 4.0, _NOTHING)
    half = (score + np.pad(score[..., 1:], last)) / 2.0
    return np.maximum(chi_square(whitener, score / own, 1.0 / own), chi_square(whitener, half / amid, 1.0 / amid))


def score_episodes(score: Floats, information: Floats, whitener: Floats) -> Floats:
    """Chi-square of a step before a month that another takes back before a later one, shape (series, month, month)."""
    own = np.diagonal(information, axis1=2, axis2=3)
    of_both = own[..., :, None] + own[..., None, :] - information - np.swapaxes(information, 2, 3)
    of_both = np.maximum(of_both, _NOTHING)
    return chi_square(whitener, (score[..., :, None] - score[..., None, :]) / of_both, 1.0 / of_both)


def score_slope(inverse: Floats, columns: Floats, fit: Fit, whitener: Floats, slope: Floats) -> Floats:
    """Chi-square of a slope, shape (series,); `slope` is its column, shape (month,)."""
    weighted = inverse @ slope
    beside = (weighted[:, :, None, :] @ columns)[:, :, 0]
    described = np.sum((beside[:, :, None, :] @ fit.covariance)[:, :, 0] * beside, axis=-1)
    information = np.maximum(weighted @ slope - described, _NOTHING)
    return chi_square(whitener, (fit.weighted_residual @ slope) / information, 1.0 / information)


def chi_square(whitener: Floats, size: Floats, variance: Floats) -> Floats:
    """Chi-square of sizes, shape (mode, ...), the modes made uncorrelated."""
    z = np.tensordot(whitener, size / np.sqrt(np.maximum(variance, 1e-300)), axes=1)
    return np.asarray(np.sum(z**2, axis=0))


def find_significance(chi2: Floats, modes: int) -> Floats:
    """Standard deviations of a normal with the probability of chi-squares of `modes` degrees of freedom, shape kept.

    Both sides of the normal count; of a very large chi-square it is the root.
    """
    p = scipy.special.chdtrc(modes, chi2)
    return np.asarray(np.where(p > _SMALLEST_P, -scipy.special.ndtri(np.maximum(p, _SMALLEST_P) / 2.0), np.sqrt(chi2)))


def find_threshold(false_alarms: float, trials: int, modes: int) -> float:
    """The chi-square of `modes` degrees of freedom that a trial exceeds by chance in `false_alarms` of all cases."""
    return float(scipy.special.chdtri(modes, false_alarms / max(trials, 1)))


# The date of a step, from events: months only say between which of them to look.
#
# Given its size, a step at the date t changes the likelihood by the events between t and any other date. With a uniform
# prior in time that is a probability of t, constant between two events: its median is the date, and the interval that
# holds 95 % of it is stated beside its standard deviation. Where a path was silent, that interval is the gap.

MONTH_S = 31 * 86_400.0
REACH_S = 2 * MONTH_S
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
    # where a path is silent, all of its silence is near
    is_known, near = np.isfinite(gain), near_unix[:, None]
    first = np.max(np.where(is_known & (time_unix <= near), time_unix, -np.inf), axis=1, initial=-np.inf)
    last = np.min(np.where(is_known & (time_unix >= near), time_unix, np.inf), axis=1, initial=np.inf)
    is_gap = (time_unix[1:] >= np.where(np.isfinite(first), first, near_unix)[:, None] - REACH_S) & (
        time_unix[:-1] <= np.where(np.isfinite(last), last, near_unix)[:, None] + REACH_S
    )
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


def widen(date: Floats, errors: Floats, begins: Floats, gain: Floats) -> Floats:
    """Errors of dates and their intervals, shape (3, step), with the probability of months farther than a month.

    Parameters
    ----------
    date, errors
        Shape (step,), and from events alone, shape (3, step).
    begins
        When months begin, shape (month,).
    gain
        Chi-square of a step before every month less that of the one with the date, shape (step, month); 0 where none is
        possible is far less.
    """
    apart = begins - date[:, None]
    near = np.minimum(errors[1], date)[:, None] - MONTH_S, np.maximum(errors[2], date)[:, None] + MONTH_S
    is_far = (begins < near[0]) | (begins > near[1])
    far = np.where(is_far, np.exp(0.5 * np.minimum(gain, 0.0)), 0.0) * MONTH_S
    of_events = np.sqrt(2.0 * np.pi) * errors[0]
    total = of_events + far.sum(axis=1)
    sigma = np.sqrt((of_events * errors[0] ** 2 + np.sum(far * apart**2, axis=1)) / total)
    before = np.cumsum(far, axis=1) / total[:, None]
    after = np.cumsum(far[:, ::-1], axis=1)[:, ::-1] / total[:, None]
    earliest = np.where(before > OUTER, begins, np.inf).min(axis=1)
    latest = np.where(after > OUTER, begins, -np.inf).max(axis=1)
    return np.stack([sigma, np.minimum(errors[1], earliest), np.maximum(errors[2], latest)])


# The noise of monthly series: that of events, and what lasts longer than an event, estimated from all series.
#
# The mean of n events has the variance 1/n in units of the event noise. Weather, read-out and whatever nobody models
# add a process that lasts: rho exp(-|dt| / L). Its level and length are common to the series of one kind and one mode;
# the likelihood over a grid of both decides (residual maximum likelihood: offset, season, slope and one step are
# marginalised).

LENGTHS_MONTHS = (0.3, 2.0, 8.0, 30.0)
LEVELS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Variance of the process over that of the mean of a typical month's events."""
MOST_SERIES = 150
"""As many series determine two numbers."""
NO_EVENTS = 1e-6
_FREE = 1e4


@dataclass(frozen=True)
class Lasting:
    """Correlated noise of months: its variance in units of the event noise, and its correlation length in months."""

    variance: float
    length_months: float

    def covariance(self, months: NDArray[np.datetime64]) -> Floats:
        """Covariance between months, shape (month, month)."""
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
        How many events each month has, shape (series, month).
    smooth
        Offset, season and slope at the months, shape (month, 6).
    scale
        The event noise, shape (series,).
    months
        Shape (month,).
    more
        One more column of each series that is no noise, shape (series, month); zeros where there is none.
    """
    if not np.any(events > 0):
        return Lasting(0.0, 1.0)
    some = slice(None, None, max(1, -(-len(y) // MOST_SERIES)))
    fixed = fixed_covariance(events[some], smooth, scale[some], months, more[some])
    of_month = 1.0 / np.median(events[some][events[some] > 0])
    grid = [Lasting(0.0, 1.0)]
    grid += [Lasting(level * of_month, length) for level in LEVELS[1:] for length in LENGTHS_MONTHS]
    return min(grid, key=lambda one: minus_log_likelihood(fixed + one.covariance(months), y[some]).sum())


def fixed_covariance(
    events: Floats, smooth: Floats, scale: Floats, months: NDArray[np.datetime64], more: Floats
) -> Floats:
    """Covariance of what does not last, shape (series, month, month); arguments as in `estimate_lasting`."""
    prior = np.full((len(events), smooth.shape[1]), _FREE)
    prior[:, OFFSET + 1 : SLOPE] = (np.array(SEASON_PRIOR) / scale[:, None]) ** 2
    fixed = (smooth * prior[:, None, :]) @ smooth.T + _FREE * more[:, :, None] * more[:, None, :]
    fixed[:, np.arange(len(months)), np.arange(len(months))] += 1.0 / np.maximum(events, NO_EVENTS)
    return np.asarray(fixed)


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


# What the series of a group have in common in an event: their median. A series is compared with the median of its
# companions without itself: a median that holds it hides a part of its noise, which makes errors too small.

FEWEST_COMPANIONS = 3
"""The median of fewer series is too much the series itself."""


def median_of_members(values: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Median of the series of a group at every event, and of the others: shapes (event, mode), (series, event, mode).

    NaN where fewer than three are known.
    """
    ordered = np.sort(values, axis=0)  # NaN last
    known = np.isfinite(values).sum(axis=0)
    known[known < FEWEST_COMPANIONS] = 0
    below, lower, upper, above = (
        np.where(known, np.take_along_axis(ordered, np.clip(at, 0, len(values) - 1)[None], axis=0)[0], np.nan)
        for at in (known // 2 - 1, (known - 1) // 2, known // 2, known // 2 + 1)
    )
    is_even = known % 2 == 0
    of_low = np.where(is_even, upper, (upper + above) / 2)
    of_high = np.where(is_even, lower, (below + lower) / 2)
    of_middle = np.where(is_even, upper, (below + above) / 2)
    others = np.where(values < lower, of_low, np.where(values > lower, of_high, of_middle))
    return ((lower + upper) / 2).astype(np.float32), others.astype(np.float32)


LEAKAGE = 1.5
"""The median of n series follows a step of k of them by up to this times k / (n - 1), and the other series step against
it."""
MOST_STEPS = 8
FEWEST_EVENTS = 10
"""Events on either side of a step."""
NOISE_ROUNDS = 4
"""Fits, the first among them, after which the noise is known well enough."""
SMALLEST_NOISE = 1e-4
"""Noise of one event, in ln C: exact data, or none, keep a finite weight."""
AT_ONCE = 32
"""Series that are worked on at once: in single events all others hold their values and medians alone."""


def share_out(rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Share rows out into parts of as many series as are worked on at once."""
    return [rows[first : first + AT_ONCE] for first in range(0, rows.size, AT_ONCE)]


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


@dataclass(frozen=True)
class _Noise:
    """What lasts of each mode, the steps that stand out of it, shape (series, month), and -2 ln of the likelihood."""

    lasting: tuple[Lasting, ...]
    steps: Floats
    cost: float


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
    common
        Median of the other series of the group, shape (series, event, mode).
    scale
        Noise of one event, shape (mode, series).
    lasting
        The process beside it, for each mode.
    result
        The fit of all series.
    cut
        The chi-square that something found exceeds.
    is_white
        Whether the noise is taken for white.
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
        self.y, self.scale = np.zeros((modes, count, len(self.months))), np.ones((modes, count))
        theta = np.zeros((modes, count, STEPS + dates.shape[1]))
        theta[:, :, OFFSET] = np.nan_to_num(median_over(series.values, axis=1)).T
        self.result = Fit(theta, np.zeros((*theta.shape, theta.shape[2])), np.zeros_like(self.y))
        self.inverse = np.zeros((*self.y.shape, len(self.months)))
        self.events = np.zeros(self.y.shape[1:])
        self.median = np.zeros((int(series.group.max()) + 1, events, modes), dtype=np.float32)
        self.common, self.is_known = np.zeros_like(series.values), np.zeros((count, events), dtype=bool)
        self.is_new = np.ones(len(self.median), dtype=bool)
        self.cut = find_threshold(false_alarms, 2 * count * len(self.months), modes)
        self.lasting: tuple[Lasting, ...] = ()
        self.rounds, self.is_white = 0, False
        self.all = np.arange(count)

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """Where series have steps that nobody knew beforehand, shape (series, step)."""
        return np.isfinite(self.terms.dates) & ~self.terms.is_known

    def fit(self) -> None:
        """Remove medians, average months, estimate the noise, and fit."""
        for g in np.flatnonzero(self.is_new):
            members = np.flatnonzero(self.series.group == g)
            left = self.series.values[members] - self.predict(members)
            self.median[g], self.common[members] = median_of_members(left)
        for some in share_out(self.all):
            rest = self.series.values[some] - self.common[some]
            self.is_known[some] = np.isfinite(rest[..., 0])
            known = self.is_known[some, :, None]
            off = np.where(known, rest - self.predict(some), 0.0)
            self.events[some] = np.add.reduceat(self.is_known[some].astype(float), self.starts, axis=1)
            total = np.maximum(self.is_known[some].sum(axis=1), 1)[:, None]
            self.scale[:, some] = np.maximum(np.sqrt(np.sum(off**2, axis=1, dtype=float) / total), SMALLEST_NOISE).T
            mean = np.add.reduceat(np.where(known, rest, 0.0), self.starts, axis=1, dtype=float)
            mean /= np.maximum(self.events[some], 1.0)[..., None]
            self.y[:, some] = np.moveaxis(mean, -1, 0) / self.scale[:, some, None]
        if self.is_white or self.rounds < NOISE_ROUNDS:
            self._estimate_noise()
        self.rounds += 1
        self.fit_terms(self.all)

    def _estimate_noise(self) -> None:
        """Estimate what lasts, from residuals with and without steps, whichever explain the series better.

        With the best step of each series left out of them, a few series that wander have little noise that lasts, and
        many steps; with none left out, a step in one of few is noise of all. Each step costs the threshold.
        """
        white = (Lasting(0.0, 1.0),) * len(self.y)
        self._weigh(white)
        self.fit_terms(self.all)
        left = np.empty_like(self.y)
        for some in share_out(self.all):
            left[:, some] = self.y[:, some] - (self.columns(some) @ self.result.theta[:, some, :, None])[..., 0]
        self.whitener = find_whitener(correlate_modes(left, self.events))
        if self.is_white:
            self.lasting = white
            return
        of_white, _ = self._find_steps()
        still = self._try_noise(left, np.zeros_like(of_white))
        options = [still, *(self._try_noise(left, steps) for steps in (still.steps, of_white) if np.any(steps))]
        self.lasting = min(options, key=lambda one: one.cost).lasting
        self._weigh(self.lasting)

    def _try_noise(self, left: Floats, steps: Floats) -> _Noise:
        """Estimate the noise with steps of free size, shape (series, month), in residuals, and find its own steps."""
        lasting = tuple(
            estimate_lasting(y, self.events, self.smooth_months, scale, self.months, steps)
            for y, scale in zip(left, self.scale, strict=True)
        )
        self._weigh(lasting)
        self.fit_terms(self.all)
        own_steps, gain = self._find_steps()
        cost = 0.0
        for some in share_out(self.all):
            for y, scale, one in zip(left, self.scale, lasting, strict=True):
                events, none = self.events[some], np.zeros((some.size, len(self.months)))
                fixed = fixed_covariance(events, self.smooth_months, scale[some], self.months, none)
                cost += minus_log_likelihood(fixed + one.covariance(self.months), y[some]).sum()
        return _Noise(lasting, own_steps, cost - gain)

    def _find_steps(self) -> tuple[Floats, float]:
        """The best step of each series, shape (series, month), and by how much they explain more than their price.

        A step of one of few moves the medians of the others: at its date they have one, too, of which counts what may
        leak, beyond chance.
        """
        steps, _ = self.scores(self.all)
        score = steps.max(axis=1)
        most = np.array([np.argmax(np.where(self.series.group == g, score, -1.0)) for g in range(len(self.median))])
        of = np.where(score > self.cut, self.all, most[self.series.group])
        best = np.argmax(steps, axis=1)[of]
        is_step = score[of] > self.cut
        others = np.maximum(np.bincount(self.series.group)[self.series.group] - 1, 1)
        own, leaks = steps[self.all, best], (LEAKAGE / others) ** 2 * score[of]
        of_chance = np.minimum(own, leaks) - np.minimum(len(self.scale), leaks)
        gain = np.where(score > self.cut, own - self.cut, of_chance)[is_step].sum()
        return ((np.arange(len(self.months)) >= best[:, None]) & is_step[:, None]).astype(float), float(gain)

    def _weigh(self, lasting: Sequence[Lasting]) -> None:
        """Weigh the months of every series by the process of each mode."""
        for some in share_out(self.all):
            inverse = {one: invert_covariance(self.events[some], one, self.months) for one in set(lasting)}
            self.inverse[:, some] = np.stack([inverse[one] for one in lasting])

    def columns(self, rows: NDArray[np.int64]) -> Floats:
        """The columns of some series, shape (series, month, column)."""
        terms = Terms(self.terms.has_slope[rows], self.terms.dates[rows], self.terms.is_known[rows])
        return month_columns(self.smooth_months, terms, self.series.time_unix, self.is_known[rows], self.starts)

    def fit_terms(self, rows: NDArray[np.int64]) -> None:
        """Fit the series of some rows, and keep their results."""
        for some in share_out(rows):
            fit = fit_terms(self.y[:, some], self.inverse[:, some], self.columns(some), self.scale[:, some])
            for name in ("theta", "covariance", "weighted_residual"):
                getattr(self.result, name)[:, some] = getattr(fit, name)

    def predict(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Predict ln C of some series at every event, shape (series, event, mode)."""
        size, dates = self.result.theta[:, rows] * self.scale[:, rows, None], self.terms.dates[rows]
        model = np.moveaxis(size[:, :, :STEPS] @ self.smooth.T, 0, -1)
        for j in range(dates.shape[1]):
            used = np.flatnonzero(np.isfinite(dates[:, j]))
            is_after = self.series.time_unix >= dates[used, j, None]
            model[used] += is_after[..., None] * size[:, used, STEPS + j].T[:, None, :]
        return model.astype(np.float32, order="C")

    def scores(self, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Chi-square of a step before every month, shape (series, month), and of a slope, shape (series,)."""
        steps, slopes = np.zeros(self.events.shape), np.zeros(self.all.size)
        for some in share_out(rows):
            known = self.inverse[:, some], self.columns(some), self._fit_of(some)
            steps[some] = np.where(self._may_step(some), score_steps(*profile_steps(*known), self.whitener), 0.0)
            slopes[some] = score_slope(*known, self.whitener, self.smooth_months[:, SLOPE])
        return steps[rows], np.where(self.terms.has_slope[rows], 0.0, slopes[rows])

    def find_episodes(self) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
        """The best two steps of each series of which one takes the other back: chi-square, and before which months.

        The price of the second step is taken off. Shape (series,) each.
        """
        best, first, last = np.zeros(self.all.size), *np.zeros((2, self.all.size), dtype=np.int64)
        for some in share_out(self.all):
            profiled = profile_steps(self.inverse[:, some], self.columns(some), self._fit_of(some))
            may, before = self._may_step(some), np.cumsum(self.events[some], axis=1) - self.events[some]
            may = may[:, :, None] & may[:, None] & (before[:, None] - before[:, :, None] >= FEWEST_EVENTS)
            may &= (np.isinf(self.terms.dates[some]).sum(axis=1) > 1)[:, None, None]
            chi2 = np.where(may, score_episodes(*profiled, self.whitener) - self.cut, 0.0).reshape(some.size, -1)
            best[some], (first[some], last[some]) = chi2.max(axis=1), np.divmod(chi2.argmax(axis=1), may.shape[2])
        return best, first, last

    def _fit_of(self, rows: NDArray[np.int64]) -> Fit:
        return Fit(*(one[:, rows] for one in vars(self.result).values()))

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

    def put_steps(self, rows: NDArray[np.int64], *months: NDArray[np.int64]) -> None:
        """Give series steps before some months each, and date them from events, each beside the others."""
        for parts in zip(share_out(rows), *map(share_out, months), strict=True):
            some, free = parts[0], list[NDArray[np.intp]]()
            for before in parts[1:]:
                free.append(np.argmax(np.isinf(self.terms.dates[some]), axis=1))
                self._set_dates(some, free[-1], self.series.time_unix[self.starts[before]])
            for step in [*free, *free]:
                self._date(some, step)

    def _date(self, some: NDArray[np.int64], step: NDArray[np.intp]) -> None:
        """Date a step of each of some series."""
        self.fit_terms(some)
        size = self.result.theta[:, some, STEPS + step].T
        near = self.terms.dates[some, step]
        is_after = (self.series.time_unix >= near[:, None])[..., None]
        left = self.series.values[some] - self.common[some] - self.predict(some)
        left = left / self.scale.T[some][:, None, :] + is_after * size[:, None]
        found = find_dates(self.series.time_unix, left @ self.whitener.T, size @ self.whitener.T, near)
        self._set_dates(some, step, found.date)
        self.errors[:, some, step] = found.sigma, found.earliest, found.latest

    def widen_dates(self) -> None:
        """Add to the errors of dates that a step in another month, with a size of its own, explains about as much."""
        begins, chi2 = self.series.time_unix[self.starts], self.own_chi2()[0]
        is_free = self.is_free
        for j in np.flatnonzero(np.any(is_free, axis=0)):
            rows, before, errors = np.flatnonzero(is_free[:, j]), self.terms, self.errors.copy()
            self.remove(is_free & (np.arange(is_free.shape[1]) == j), np.zeros_like(before.has_slope))
            self.fit_terms(rows)
            steps, _ = self.scores(rows)
            self.restore(before, errors, rows)
            self.fit_terms(rows)
            self.errors[:, rows, j] = widen(
                before.dates[rows, j], errors[:, rows, j], begins, steps - chi2[rows, j, None]
            )

    def total_cost(self) -> float:
        """-2 ln of the likelihood of all events, and the threshold for every term.

        Single events scatter in a month by their own noise, whatever lasts. A step of one is seen in those that are
        compared with it as well, which are no evidence of their own.
        """
        cost = np.zeros(self.all.size)
        for some in share_out(self.all):
            left = self.y[:, some] - (self.columns(some) @ self.result.theta[:, some, :, None])[..., 0]
            events, none = self.events[some], np.zeros((some.size, len(self.months)))
            for y, scale, one in zip(left, self.scale[:, some], self.lasting, strict=True):
                fixed = fixed_covariance(events, self.smooth_months, scale, self.months, none)
                cost[some] += minus_log_likelihood(fixed + one.covariance(self.months), y)
                cost[some] += 2.0 * events.sum(axis=1) * np.log(scale) - np.sum(events * y**2, axis=1)
        seen = 1.0 + LEAKAGE**2 / np.maximum(np.bincount(self.series.group)[self.series.group] - 1, 1)
        return float(np.sum(cost / seen) + self.cut * (self.is_free.sum() + self.terms.has_slope.sum()))

    def _set_dates(self, rows: NDArray[np.int64], step: NDArray[np.int64], dates: Floats) -> None:
        new = self.terms.dates.copy()
        new[rows, step] = dates
        self.terms = replace(self.terms, dates=new)

    def find_cost(self, rows: NDArray[np.int64]) -> Floats:
        """Chi-square of series, shape (series,), and the threshold for every term that they have.

        That of their months, and of events about the means of these: a step within a month is seen there alone.
        """
        chi2 = np.sum(self.y[:, rows] * self.result.weighted_residual[:, rows], axis=(0, 2))
        for some, at in zip(share_out(rows), share_out(np.arange(rows.size)), strict=True):
            left = (self.series.values[some] - self.common[some] - self.predict(some)) / self.scale.T[some][:, None]
            left = np.nan_to_num(left, nan=0.0)
            mean = np.add.reduceat(left, self.starts, axis=1) / np.maximum(self.events[some], 1.0)[..., None]
            chi2[at] += np.sum(left**2, axis=(1, 2)) - np.sum(self.events[some][..., None] * mean**2, axis=(1, 2))
        count = np.isfinite(self.terms.dates[rows]).sum(axis=1) + self.terms.has_slope[rows]
        return np.asarray(chi2 + self.cut * count)
