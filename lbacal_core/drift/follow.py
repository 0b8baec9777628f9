"""Everything that is known of an array over time: every path, every station's polarisations, and the whole.

A path is compared with the median of its station's other paths of the same polarisation, which see the same sky in the
same event; the medians of stations are compared with one another; and that of all is the whole. So a step of one path,
one of a station, and what all of them share are told apart, and each is reported once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from lbacal_core.drift.events import MODES, EventModes, find_months
from lbacal_core.drift.model import FEWEST_COMPANIONS, SLOPE, Series, smooth_columns
from lbacal_core.drift.search import Found, search_series
from lbacal_core.grids import YEAR_S, Floats
from lbacal_core.linear import fit_least_squares, invert_symmetric

# What all paths share: the trend of the whole, beside its scatter from year to year.
#
# The mean of many paths has no companions to be compared with. It moves by about 5 % from year to year (Mulrey et al.
# 2019, section 4), and a slope must be told from that: the season is removed, and the means of whole years are fitted
# with a line. Nothing says that levels change where our years begin. A level that lasts a year and changes at another
# date, or smoothly, gives the means of neighbouring years a correlation of up to 1/2; with independent years assumed,
# the stated error held 57 % instead of 68.3 %. Seven means do not determine the correlation, and so the slope is
# averaged over it: a mixture of Student's t, each with two degrees of freedom fewer than there are years, weighted by
# the residual likelihood of the years. With 5 % a year and seven years the error is about 1 % a year: no method can do
# much better.

FEWEST_YEARS = 3
FEWEST_MONTHS = 6
"""Months that make a year, from the first event on."""
CORRELATIONS = tuple(np.linspace(0.0, 0.5, 6).tolist())
"""Means of neighbouring years: 0 where levels change at the turns of our years, 1/2 where they do half a year later."""
ONE_SIGMA, LIMIT = 0.682689492137086, 0.95


@dataclass(frozen=True)
class Whole:
    """The trend of what all paths share; changes of ln C, one entry a mode.

    Attributes
    ----------
    slope, sigma, limit
        A year; slope +- sigma holds 68.3 % of the probability, and slope +- limit 95 %.
    scatter
        Standard deviation of a year about the line.
    years
        How many there are.
    p_value
        Probability of so large a slope without one, of the gain.
    middle_unix
        Mean time of the years, s UTC.
    season
        Coefficients of the columns of `smooth_columns`, shape (4, mode).
    """

    slope: Floats
    sigma: Floats
    limit: Floats
    scatter: Floats
    years: int
    p_value: float
    middle_unix: float
    season: Floats


def measure_whole(time_unix: Floats, values: Floats) -> Whole | None:
    """Fit the trend; None where there are fewer than three years.

    Parameters
    ----------
    values
        What all paths share, shape (event, mode), NaN where unknown.
    """
    is_known = np.isfinite(values[:, 0])
    time_unix, values = time_unix[is_known], values[is_known]
    if time_unix.size == 0:
        return None
    _, starts = find_months(time_unix)
    events = np.diff(np.append(starts, time_unix.size))[:, None]
    y = np.add.reduceat(values, starts, axis=0, dtype=float) / events
    smooth = np.add.reduceat(smooth_columns(time_unix, time_unix[0]), starts, axis=0) / events
    year = np.floor(smooth[:, SLOPE]).astype(int)
    kept = [number for number in range(int(year.max()) + 1) if np.sum(year == number) >= FEWEST_MONTHS]
    if len(kept) < FEWEST_YEARS:
        return None
    is_of = (year[:, None] == np.arange(int(year.max()) + 1)).astype(float)
    columns = np.hstack([is_of, smooth[:, 1:SLOPE], smooth[:, SLOPE, None]])
    season = fit_least_squares(columns, y)[is_of.shape[1] : -1]
    mean = is_of.T[kept] / is_of.T[kept].sum(axis=1, keepdims=True)
    level, when = mean @ (y - smooth[:, 1:SLOPE] @ season), mean @ smooth[:, SLOPE]
    middle_unix = float(time_unix[0] + when.mean() * YEAR_S)
    fits = [_fit_line(np.array(kept), when - when.mean(), level, correlation) for correlation in CORRELATIONS]
    found = [_Mixture.of([fit[mode] for fit in fits], len(kept) - 2) for mode in range(level.shape[1])]
    slope, sigma, limit = (
        np.array(values) for values in zip(*((m.mean, m.reach(ONE_SIGMA), m.reach(LIMIT)) for m in found), strict=True)
    )
    p_value = 1.0 - found[0].part_within(abs(found[0].mean))
    return Whole(slope, sigma, limit, _scatter(when, level), len(kept), p_value, middle_unix, season)


@dataclass(frozen=True)
class _Line:
    """The slope of one mode for one correlation of years, its error, and the logarithm of the likelihood."""

    slope: float
    error: float
    log_likelihood: float


def _fit_line(year: NDArray[np.int64], when: Floats, level: Floats, correlation: float) -> list[_Line]:
    """Fit the means of years, shape (year, mode), whose correlation falls with their distance as a power."""
    apart = np.abs(year[:, None] - year)
    covariance = np.where(apart == 0, 1.0, correlation ** np.maximum(apart, 1))
    inverse = invert_symmetric(covariance)
    columns = np.stack([np.ones_like(when), when], axis=1)
    of_line = invert_symmetric(columns.T @ inverse @ columns)
    theta = of_line @ columns.T @ inverse @ level
    left = level - columns @ theta
    freedom = year.size - 2
    chi2 = np.maximum(np.sum(left * (inverse @ left), axis=0), 1e-300)
    constant = 0.5 * np.linalg.slogdet(of_line)[1] - 0.5 * np.linalg.slogdet(covariance)[1]
    return [
        _Line(
            float(slope), float(np.sqrt(one / freedom * of_line[1, 1])), float(constant - 0.5 * freedom * np.log(one))
        )
        for slope, one in zip(theta[1], chi2, strict=True)
    ]


@dataclass(frozen=True)
class _Mixture:
    """The probability of a slope: Student's t about several values, with their weights."""

    slope: Floats
    error: Floats
    weight: Floats
    freedom: int

    @classmethod
    def of(cls, lines: list[_Line], freedom: int) -> _Mixture:
        """Weight lines by their likelihood."""
        slope, error, log_likelihood = (
            np.array([getattr(one, name) for one in lines]) for name in ("slope", "error", "log_likelihood")
        )
        weight = np.exp(log_likelihood - log_likelihood.max())
        return cls(slope, error, weight / weight.sum(), freedom)

    @property
    def mean(self) -> float:
        """The slope that is told."""
        return float(self.weight @ self.slope)

    def part_within(self, reach: float) -> float:
        """The probability of the slopes that differ from the mean by less than this."""
        ends = self.mean + np.array([[-reach], [reach]])
        low, high = stdtr(self.freedom, (ends - self.slope) / self.error)
        return float(self.weight @ (high - low))

    def reach(self, part: float) -> float:
        """How far from the mean this part of the probability lies."""
        farthest = float(np.max(np.abs(self.slope - self.mean) + self.error * stdtrit(self.freedom, (1 + part) / 2)))
        return float(brentq(lambda reach: self.part_within(reach) - part, 0.0, farthest, xtol=1e-12))


def _scatter(when: Floats, level: Floats) -> Floats:
    """Standard deviation of years about the straight line through them, one entry a mode."""
    left = level - np.polynomial.polynomial.polyval(when, np.polynomial.polynomial.polyfit(when, level, 1)).T
    return np.asarray(np.sqrt(np.sum(left**2, axis=0) / (when.size - 2)))


BOTH = "XY"
"""The polarisation of a group that has both."""


@dataclass(frozen=True)
class History:
    """ln(C / C_reference) of an array's paths in all events.

    Attributes
    ----------
    station, antenna, dipole
        Shape (path,).
    time_unix
        Shape (event,), rising.
    ln_c
        Shape (path, event, mode), NaN where nothing was measured.
    known_unix
        Dates at which a path's hardware changed, shape (path, change), infinite where there is none.
    """

    station: NDArray[np.str_]
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    time_unix: Floats
    ln_c: NDArray[np.float32]
    known_unix: Floats

    @classmethod
    def of(
        cls, modes: Sequence[tuple[str, str, EventModes]], changes: Mapping[tuple[str, int], Sequence[float]]
    ) -> History:
        """Lay events, each with its station and dipole, on one axis.

        Parameters
        ----------
        changes
            Dates of hardware changes, s UTC, by station and antenna: the path's own events tell the size of one, if
            there are some before and after it.
        """
        keys = sorted({(name, antenna, letter) for name, letter, one in modes for antenna in one.antennas.tolist()})
        row = {key: k for k, key in enumerate(keys)}
        time_unix = np.unique(np.concatenate([one.time_unix for *_, one in modes]))
        ln_c = np.full((len(keys), time_unix.size, len(MODES)), np.nan, dtype=np.float32)
        for name, letter, one in modes:
            rows = np.array([row[name, antenna, letter] for antenna in one.antennas.tolist()], dtype=np.int64)
            ln_c[np.ix_(rows, np.searchsorted(time_unix, one.time_unix))] = one.ln_c
        dates = [changes.get((station, antenna), ()) for station, antenna, _ in keys]
        known = np.full((len(keys), max(map(len, dates), default=0)), np.inf)
        for k, of_path in enumerate(dates):
            known[k, : len(of_path)] = of_path
        station, antenna, dipole = (np.array(column) for column in zip(*keys, strict=True))
        history = cls(station, antenna.astype(np.int64), dipole, time_unix, ln_c, known)
        first, last = history.spans
        known[(known <= first[:, None]) | (known > last[:, None])] = np.inf
        return history

    @property
    def spans(self) -> tuple[Floats, Floats]:
        """The first and the last event of each path, s UTC; infinite where it has none."""
        is_known = np.isfinite(self.ln_c[..., 0])
        first = np.where(is_known, self.time_unix, np.inf).min(axis=1)
        return first, np.where(is_known, self.time_unix, -np.inf).max(axis=1)


@dataclass(frozen=True)
class Followed:
    """The drift of paths, stations and the array, with its steps, slopes and seasons.

    Attributes
    ----------
    groups
        (station, dipole) of each group of paths.
    paths
        Paths against their group's median.
    stations
        Groups against the median of the stations; None with fewer than three.
    whole
        The trend of what all share; None with fewer than three years.
    """

    groups: tuple[tuple[str, str], ...]
    paths: Found
    stations: Found | None
    whole: Whole | None


def follow(history: History) -> Followed:
    """Find what changed."""
    groups, group = _group_paths(history)
    paths = search_series(Series(history.ln_c, group, history.time_unix), history.known_unix)
    median = paths.median
    of_dipole = np.unique([dipole for _, dipole in groups], return_inverse=True)[1]
    stations = None
    if np.any(np.bincount(of_dipole) >= FEWEST_COMPANIONS):
        stations = search_series(Series(median, of_dipole, history.time_unix))
        median = stations.median
    return Followed(groups, paths, stations, measure_whole(history.time_unix, _average(median)))


def _group_paths(history: History) -> tuple[tuple[tuple[str, str], ...], NDArray[np.int64]]:
    """The groups, and which one each path belongs to: its station's polarisation, or all of a very small station."""
    keys = list(zip(history.station.tolist(), history.dipole.tolist(), strict=True))
    few = {station for (station, _), count in Counter(keys).items() if count < FEWEST_COMPANIONS}
    keys = [(station, BOTH if station in few else dipole) for station, dipole in keys]
    groups = tuple(sorted(set(keys)))
    return groups, np.array([groups.index(key) for key in keys])


def _average(median: NDArray[np.float32]) -> Floats:
    """Mean of several medians, shape (event, mode), each less its mean over time; NaN where none is known."""
    is_known = np.isfinite(median)
    filled = np.where(is_known, median, 0.0).astype(float)
    level = filled.sum(axis=1, keepdims=True) / np.maximum(is_known.sum(axis=1, keepdims=True), 1)
    count = is_known.sum(axis=0)
    mean = np.where(is_known, filled - level, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.asarray(np.where(count > 0, mean, np.nan))
