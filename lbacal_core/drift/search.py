"""Which slopes and steps the series of one kind have: added one by one, the most significant first.

A series is a path against the median of the others of its group, or a group against that of the other groups. A round
removes the medians, averages months, fits all series, and scores a slope, a step at every month, and one that another
takes back, in each, everything that the fit describes profiled out. What passes the threshold enters the model; a step
gets its date from events; what is no longer significant beside the rest leaves, and each term may give its place to a
better one: the first step that is added to a path with several is a compromise between them, and its date is that of
medians in which others still stepped. Medians are taken again of what the model leaves, so that a step of one path in a
small group does not appear in the others; for the same reason a round adds nothing that the best of its group could
cause. A step has a date to choose, a slope has none: one is preferred to the other by the mean over the dates.

Steps of many series are noise that lasts, in which none of them stands out. Where anything lasts, the search begins
once more with what stands out in white noise. That counts if it explains more, by the threshold, than the noise does,
with the medians as they settled before and after.

A score is the sum of squares of the scores of the modes, made uncorrelated: chi-square with one degree a mode. The
threshold is that of the number of series times half months, so that `FALSE_ALARMS` are expected in all of them at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from lbacal_core.drift.model import (
    LEAKAGE,
    MONTH_S,
    MOST_STEPS,
    OFFSET,
    SLOPE,
    STEPS,
    Lasting,
    Series,
    SeriesModel,
    Terms,
    chi_square,
    find_significance,
)
from lbacal_core.grids import Floats

FALSE_ALARMS = 0.01
"""Steps and slopes expected by chance in all series together; nightly looks at growing data make some times as many."""
MOST_ROUNDS = 40
SETTLING_ROUNDS = 2
BETTER = 2.0
"""Chi-square by which a term must explain more than the one whose place it takes."""
ALIKE = 0.25
"""Share of the best chi-square of a group from which on series count as those that step."""
MOST_LEAKAGE = 0.9
"""A round adds nothing with less chi-square, as a share of the group's best, than what leaks has, nor more than this of
it. Once it were in the model, medians would be taken without it, and nothing could tell any more who stepped."""
MOST_EXPLAINED = 0.99
"""Share of the variance of single events that a term explains at most; the logarithm of the rest stays finite."""


def over_dates(steps: Floats) -> Floats:
    """Twice the log likelihood ratio of a step at a date that nobody knows, of months alike likely before.

    Parameters
    ----------
    steps
        Chi-square of a step before every month, 0 where none is possible, shape (series, month).
    """
    return np.asarray(2.0 * (logsumexp(steps / 2.0, axis=1) - np.log(steps.shape[1])))


def within_month(sigma_s: Floats) -> Floats:
    """Twice the log likelihood ratio of the date of a step, with its error, and of all dates of its month, s."""
    return np.asarray(2.0 * np.log(np.maximum(MONTH_S / (np.sqrt(2.0 * np.pi) * np.maximum(sigma_s, 1.0)), 1.0)))


def free_noise(chi2: Floats, values: NDArray[np.int64]) -> Floats:
    """Twice the log likelihood ratio of a term that is not in the model yet, with which the noise of all modes is less.

    Parameters
    ----------
    chi2
        In units of the noise without it.
    values
        Events times modes that a series has, which no chi-square exceeds; shapes that broadcast.
    """
    return np.asarray(-values * np.log1p(-np.minimum(chi2 / np.maximum(values, 1), MOST_EXPLAINED)))


@dataclass(frozen=True)
class Found:
    """Steps and slopes of series. Sizes are changes of ln C (of its modes), a slope is one a year.

    Attributes
    ----------
    terms
        Slopes and steps.
    events
        How many events of each series had companions to compare it with, shape (series,).
    step_sigma_s, step_earliest, step_latest
        Error of the dates and the interval that holds 95 %, shape (series, step); NaN where there is none.
    step_size, step_size_sigma
        Shape (series, step, mode).
    step_significance
        Standard deviations of a normal with the same probability, shape (series, step).
    slope, slope_sigma
        Those of every series, significant or not, shape (series, mode).
    slope_significance
        Shape (series,).
    season, season_sigma
        The annual term, cosine and sine, shape (series, 2, mode).
    season_significance
        Shape (series,).
    median
        What each group has in common, shape (group, event, mode).
    noise
        Noise of one event, shape (series, mode).
    lasting
        The process beside it, for each mode.
    threshold
        Significance from which on something is found.
    """

    terms: Terms
    events: NDArray[np.int64]
    step_sigma_s: Floats
    step_earliest: Floats
    step_latest: Floats
    step_size: Floats
    step_size_sigma: Floats
    step_significance: Floats
    slope: Floats
    slope_sigma: Floats
    slope_significance: Floats
    season: Floats
    season_sigma: Floats
    season_significance: Floats
    median: NDArray[np.float32]
    noise: Floats
    lasting: tuple[Lasting, ...]
    threshold: float


def search_series(series: Series, known_unix: Floats | None = None, false_alarms: float = FALSE_ALARMS) -> Found:
    """Find slopes and steps.

    Parameters
    ----------
    known_unix
        Dates at which the hardware of a series changed, shape (series, change), infinite where there is none: steps
        whose size is free and that are not reported.
    false_alarms
        Steps and slopes that a search finds by chance, on average.
    """
    search = _Search(series, known_unix, false_alarms)
    search.fit()  # before it, the season counts as noise of events
    found, terms, errors = search.run(), search.terms, search.errors.copy()
    if not any(one.variance for one in search.lasting) or not search.add_to_white_noise():
        return found
    of_white = search.terms, search.errors.copy()
    cost = search.settle_cost(terms, errors) - search.cut
    search.begin(*of_white)
    other = search.run()
    of_other = search.settle_cost(search.terms, search.errors)
    if of_other >= cost:
        return found
    search.remove(search.is_free, search.terms.has_slope)
    search.begin(search.terms, search.errors)  # with the terms that are known, and medians as settled
    found = search.run()
    return other if of_other < search.settle_cost(search.terms, search.errors) - search.cut else found


class _Search(SeriesModel):
    """A model and what was tried with it."""

    def __init__(self, series: Series, known_unix: Floats | None, false_alarms: float) -> None:
        super().__init__(series, known_unix, false_alarms)
        members = np.bincount(series.group, minlength=len(self.median))
        self.leakage = LEAKAGE / np.maximum(members - 1, 1)
        self.was_settled, self.was_begun_again = np.zeros((2, len(series.group)), dtype=bool)

    def run(self) -> Found:
        """Estimate the noise, add terms until nothing improves, settle medians, and report."""
        self._improve_on()
        self.settle_medians()
        while self.drop():  # what the settled medians leave below the threshold
            self.fit()
        return self.report()

    def _improve_on(self) -> bool:
        """Fit and improve until nothing changes; whether anything did."""
        for k in range(MOST_ROUNDS):
            self.fit()
            if not self.improve():
                return k > 0
        return True

    def settle_cost(self, terms: Terms, errors: Floats) -> float:
        """Tell what noise and terms cost when both and the medians are settled."""
        self.begin(terms, errors)
        for _ in range(SETTLING_ROUNDS):
            self.fit()
        return self.total_cost()

    def add_to_white_noise(self) -> bool:
        """Add terms as if nothing lasted beside them; whether there are any."""
        self.begin(self.terms, self.errors)
        self.is_white = True
        has_more = self._improve_on()
        self.is_white = False
        return has_more

    def begin(self, terms: Terms, errors: Floats) -> None:
        """Begin with some terms: let noise be estimated, medians be taken and everything be tried once more."""
        self.restore(terms, errors, self.all)
        self.rounds, self.was_settled[:], self.was_begun_again[:] = 0, False, False
        self._renew(np.ones_like(self.was_settled))

    def improve(self) -> bool:
        """Drop, add, exchange terms or begin again, the first that changes anything; whether anything changed."""
        return self.drop() or self._add() or self._exchange() or self._begin_again()

    def drop(self) -> bool:
        """Take out steps and slopes below the threshold; whether there were any."""
        steps, slopes = self.own_chi2()
        is_out = self.is_free & (steps < self.cut)
        no_slope = self.terms.has_slope & (slopes < self.cut)
        self.remove(is_out, no_slope)
        return self._renew(no_slope | np.any(is_out, axis=1))

    def _add(self) -> bool:
        steps, slopes = self.scores(self.all)
        best, group = np.argmax(steps, axis=1), self.series.group
        of_episode, first, last = self.find_episodes()
        of_one = np.maximum(steps[self.all, best], slopes)
        # where one term is the best of a group, medians may hold two steps of others
        is_episode = (of_episode > of_one) & (self._of_group(of_episode) > self._of_group(of_one))[group]
        top = np.where(is_episode, of_episode, of_one)
        size = top * self.scale[0] ** 2  # what a series does not describe yet is in its noise
        of_group = self._of_group(size)
        is_alike = (top > self.cut) & (size >= ALIKE * of_group[group])
        alike = np.bincount(group, weights=is_alike, minlength=len(self.median))
        share = np.minimum(self.leakage * alike, MOST_LEAKAGE) ** 2
        is_added = (top > self.cut) & (size >= (share * of_group)[group])
        values = self.is_known.sum(axis=1) * len(self.scale)
        of_slope, of_step = free_noise(slopes, values), over_dates(free_noise(steps, values[:, None]))
        gets_slope = is_added & ~is_episode & (of_slope >= of_step)
        self.terms = replace(self.terms, has_slope=self.terms.has_slope | gets_slope)
        rows, two = np.flatnonzero(is_added & ~gets_slope & ~is_episode), np.flatnonzero(is_added & is_episode)
        self.put_steps(rows, best[rows])
        self.put_steps(two, first[two], last[two])
        return self._renew(is_added)

    def _of_group(self, values: Floats) -> Floats:
        """The largest of each group, shape (group,)."""
        found = np.zeros(len(self.median))
        np.maximum.at(found, self.series.group, values)
        return found

    def _exchange(self) -> bool:
        """Take out each term of a series in turn, and put in its place what explains more, if any does."""
        is_free = self.is_free
        asked = (np.any(is_free, axis=1) | self.terms.has_slope) & ~self.was_settled
        self.was_settled |= asked
        changed = np.zeros_like(asked)
        for j in range(-1, is_free.shape[1]):
            rows = np.flatnonzero(asked & ~changed & (self.terms.has_slope if j < 0 else is_free[:, j]))
            if rows.size:
                changed[rows[self._replace_term(rows, j)]] = True
        return self._renew(changed)

    def _replace_term(self, rows: NDArray[np.int64], step: int) -> NDArray[np.bool_]:
        """Replace a step of series, or with -1 their slope, where another term explains more; where it did."""
        before, errors, cost = self.terms, self.errors.copy(), self.find_cost(rows)
        out = np.zeros_like(before.is_known)
        if step >= 0:
            out[rows, step] = True
        self.remove(out, np.isin(self.all, rows) & (step < 0))
        self.fit_terms(rows)
        steps, slopes = self.scores(rows)
        gets_slope = (step >= 0) & (slopes > over_dates(steps))
        self.terms.has_slope[rows[gets_slope]] = True
        gets_step = ~gets_slope & np.any(steps > 0.0, axis=1)
        taken = np.isfinite(self.terms.dates[rows])
        self.put_steps(rows[gets_step], np.argmax(steps, axis=1)[gets_step])
        self.fit_terms(rows)
        # a slope has no date to choose; of a step count the others that explain as much, by months and within one
        of_month = steps.max(axis=1) - over_dates(steps)
        was = of_month + within_month(errors[0, rows, step]) if step >= 0 else 0.0
        sigma = np.where(np.isfinite(self.terms.dates[rows]) & ~taken, self.errors[0, rows], np.inf).min(axis=1)
        of_date = np.where(gets_step, of_month + within_month(sigma), 0.0)
        is_better = self.find_cost(rows) + of_date < cost + was - BETTER
        self.restore(before, errors, rows[~is_better])
        self.fit_terms(rows)
        return np.asarray(is_better)

    def settle_medians(self) -> None:
        """Take medians again of what the last model leaves, as often as they still move by it.

        A slope of six among 48 paths moves their median by an eighth of it, and every path against it: so do all slopes
        that are told, unless it is taken out. Each time leaves an eighth of what was there.
        """
        has_terms = self.terms.has_slope | np.any(np.isfinite(self.terms.dates), axis=1)
        for _ in range(SETTLING_ROUNDS if np.any(has_terms) else 0):
            self._renew(has_terms)
            self.fit()

    def _renew(self, changed: NDArray[np.bool_]) -> bool:
        """Medians of groups with a changed series are to be taken again; whether there is any."""
        self.fit_terms(np.flatnonzero(changed))
        self.is_new = np.bincount(self.series.group, weights=changed, minlength=len(self.median)) > 0
        self.was_settled &= ~self.is_new[self.series.group]
        return bool(np.any(changed))

    def _begin_again(self) -> bool:
        """Explain series that have a slope and steps by steps alone, once, and keep what costs less."""
        is_free = self.is_free
        rows = np.flatnonzero(self.terms.has_slope & np.any(is_free, axis=1) & ~self.was_begun_again)
        if rows.size == 0:
            return False
        self.was_begun_again[rows] = True
        before, errors, cost = self.terms, self.errors.copy(), self.find_cost(rows)
        of_rows = np.isin(self.all, rows)
        self.remove(is_free & of_rows[:, None], of_rows)
        self.fit_terms(rows)
        for _ in range(MOST_STEPS):
            steps, _ = self.scores(rows)
            best = np.argmax(steps, axis=1)
            is_added = steps[np.arange(rows.size), best] > self.cut
            self.put_steps(rows[is_added], best[is_added])
        for j in range(self.terms.dates.shape[1]):
            has = rows[np.isfinite(self.terms.dates[rows, j]) & ~self.terms.is_known[rows, j]]
            self._replace_term(has, j)
        back = rows[self.find_cost(rows) >= cost]
        self.restore(before, errors, back)
        self.fit_terms(back)
        return self._renew(of_rows & ~np.isin(self.all, back))

    def report(self) -> Found:
        """Report steps and slopes; slopes of all series from a fit in which each has one."""
        self.widen_dates()
        steps, _ = self.own_chi2()
        at = slice(STEPS, None)
        size = np.einsum("ksj,ks->sjk", self.result.theta[:, :, at], self.scale)
        deviation = np.sqrt(np.diagonal(self.result.covariance, axis1=2, axis2=3))
        size_sigma = np.einsum("ksj,ks->sjk", deviation[:, :, at], self.scale)
        has_step = np.isfinite(self.terms.dates)
        size[~has_step] = size_sigma[~has_step] = np.nan
        annual = slice(OFFSET + 1, OFFSET + 3)
        season, season_sigma = (one[:, :, annual] * self.scale[..., None] for one in (self.result.theta, deviation))
        # every series has a season: that of one moves the median, and by it all others, until theirs is taken out
        for g in range(len(self.median)):
            of_group = self.series.group == g
            season[:, of_group] -= np.median(season[:, of_group], axis=1, keepdims=True)
        season_chi2 = chi_square(self.whitener, season, season_sigma**2).sum(axis=1)
        terms, modes = self.terms, len(self.scale)
        self.terms = replace(terms, has_slope=np.ones_like(terms.has_slope))
        self.fit_terms(self.all)
        variance = self.result.covariance[:, :, SLOPE, SLOPE]
        slope_chi2 = chi_square(self.whitener, self.result.theta[:, :, SLOPE], variance)
        found = Found(
            terms=terms,
            events=self.is_known.sum(axis=1),
            step_sigma_s=self.errors[0].copy(),
            step_earliest=self.errors[1].copy(),
            step_latest=self.errors[2].copy(),
            step_size=size,
            step_size_sigma=size_sigma,
            step_significance=np.where(has_step, find_significance(steps, modes), np.nan),
            slope=(self.result.theta[:, :, SLOPE] * self.scale).T,
            slope_sigma=(np.sqrt(variance) * self.scale).T,
            slope_significance=find_significance(slope_chi2, modes),
            season=np.moveaxis(season, 0, -1),
            season_sigma=np.moveaxis(season_sigma, 0, -1),
            season_significance=find_significance(season_chi2, 2 * modes),
            median=self.median.copy(),
            noise=self.scale.T.copy(),
            lasting=self.lasting,
            threshold=float(find_significance(np.array(self.cut), modes)),
        )
        self.terms = terms
        self.fit_terms(self.all)
        return found
