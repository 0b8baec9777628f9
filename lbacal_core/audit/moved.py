"""Antennas that change places on a date: from then on each records what another did before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from lbacal_core.audit.antennas import CERTAIN, DATE_SIGMA, FEWEST_BESIDE, OUTLYING, SMALLEST_SPREAD, Edge, find_edge
from lbacal_core.audit.station import AuditedStation, spread
from lbacal_core.audit.verdict import WRONG, Line
from lbacal_core.drift.model import FEWEST_COMPANIONS, MONTH_S
from lbacal_core.grids import Floats

MOVED = "antennas exchanged"


@dataclass(frozen=True)
class Circle:
    """Antennas, by their rows: since a date each records what the next one did; and for which dipoles."""

    rows: tuple[int, ...]
    dipoles: tuple[int, ...]
    odds: float
    since: Edge
    until: Edge | None = None

    def ends(self, other: Circle) -> bool:
        """Whether it puts back what another, earlier one exchanged."""
        back = (other.rows[0], *other.rows[:0:-1])
        return other.until is None and self.dipoles == other.dipoles and self.rows == back


def find_moved(station: AuditedStation) -> list[Line]:
    """Antennas of which each has the level and slope of another since a date, for a time, or of one dipole alone.

    Both are those of ln P along frequency over the median antenna's, which does not care who is who, in a month before
    a date and after it. That antennas change places is held against no change, against a step of each, of any size to
    the factor of an outlying path, and against drifts, whose steps are as large half a month before and after. In data
    shorter than both months, dates are not told from sidereal time, along which exchanged letters differ.
    """
    if station.antennas.size < FEWEST_COMPANIONS or np.ptp(station.time_unix) < 2.0 * MONTH_S:
        return []
    power = np.log(station.power)
    power = power - np.nanmedian(power, axis=0)
    along = np.linspace(-0.5, 0.5, power.shape[-1])
    seen = np.stack([power.mean(axis=-1), (power * along).sum(axis=-1) / np.sum(along**2)], axis=2)
    every = tuple(range(len(station.dipoles)))
    tried = dict.fromkeys((every, *((one,) for one in every)))
    found = [one for dipoles in tried for one in _put_back(seen, list(dipoles), station.time_unix)]
    told: list[Circle] = []
    for one in sorted(found, key=lambda own: own.since.at):
        begun = next((own for own in told if one.ends(own)), None)
        if begun is None:
            told.append(one)
        else:
            told[told.index(begun)] = replace(begun, until=one.since, odds=min(one.odds, begun.odds))
    return [_tell(station, one) for one in told]


def put_in_place(station: AuditedStation, moved: Sequence[Line]) -> AuditedStation:
    """The station with each antenna in its place, as the lines of `find_moved` say."""
    if not moved:
        return station
    power = station.power.copy()
    for line in moved:
        during = np.flatnonzero(line.is_during(station.time_unix))
        own = np.searchsorted(station.antennas, line.antennas)
        for dipole, name in enumerate(station.dipoles):
            if line.dipole in (None, name):
                power[np.roll(own, -1)[:, None], dipole, during] = power[own[:, None], dipole, during]
    return replace(station, power=power)


def _put_back(seen: Floats, dipoles: list[int], time_unix: Floats) -> Iterator[Circle]:
    """Circles of antennas in values of shape (antenna, dipole, 2, time), the clearest first; each is put back."""
    is_tried = np.zeros(time_unix.size + 1, dtype=bool)
    while True:
        values = seen[:, dipoles].reshape(len(seen), -1, time_unix.size)
        before, after, error = _look_beside(values, time_unix)
        odds = _odds_of_step(before, after, error)
        others = np.delete(seen, dipoles, axis=1).reshape(len(seen), -1, time_unix.size)
        stepped = (odds > CERTAIN) & (_odds_of_step(*_look_beside(others, time_unix)) < CERTAIN)
        total = np.where(stepped & (stepped.sum(axis=0) > 1) & ~is_tried, odds, 0.0).sum(axis=0)
        k = int(np.argmax(total))
        if not total[k] > 0.0:
            return
        is_tried |= np.abs(np.arange(is_tried.size) - k) < FEWEST_BESIDE
        rows = np.flatnonzero(stepped[:, k])
        became, was, sigma = after[rows, :, k], before[rows, :, k], error[rows, :, k]
        cost = 0.5 * np.sum(((became[:, None] - was) / sigma[:, None]) ** 2, axis=-1)
        alone = np.sum(np.log(OUTLYING / sigma), axis=-1)
        np.fill_diagonal(cost, alone)
        place = linear_sum_assignment(cost)[1]
        around = np.searchsorted(time_unix, time_unix[k] + np.array([-0.5, 0.5]) * MONTH_S)
        half = np.clip(around, [0, k + FEWEST_BESIDE // 2], [k - FEWEST_BESIDE // 2, time_unix.size])
        near = np.flatnonzero(total >= total[k] - DATE_SIGMA**2 / 2)
        for cycle in _list_cycles(place):
            at = list(cycle)
            over_steps = np.sum(alone[at] - cost[at, place[at]]) - (len(at) - 1) * np.log(len(seen))
            over_none = np.sum(odds[rows[at], k] - cost[at, place[at]]) - np.log(time_unix.size)
            over_none -= len(at) * np.log(len(seen))
            over_drift = np.sum(odds[rows[at], k]) - np.sum(odds[rows[at]][:, half], axis=0).max()
            log_odds = float(min(over_steps, over_none, over_drift))
            if log_odds > CERTAIN:
                own, other = (rows[one][:, None] for one in (at, place[at]))
                seen[other, dipoles, :, k:] = seen[own, dipoles, :, k:]
                first = at.index(min(at))
                circle = tuple(rows[at[first:] + at[:first]].tolist())
                yield Circle(circle, tuple(dipoles), log_odds, find_edge(time_unix, k, near))


def _look_beside(values: Floats, time_unix: Floats) -> tuple[Floats, Floats, Floats]:
    """Means of values of shape (antenna, value, time) in the month before each split and after it, and their error.

    Shape (antenna, value, split) each, split by the number of instants before it; NaN where there are too few.
    """
    known = np.isfinite(values)
    total = np.cumsum(np.where(known, values, 0.0), axis=-1)
    count = np.cumsum(known, axis=-1)
    total, count = (np.concatenate([np.zeros((*one.shape[:2], 1)), one], axis=-1) for one in (total, count))
    k = np.arange(time_unix.size + 1)
    begin = np.minimum(np.searchsorted(time_unix, time_unix[np.minimum(k, k[-2])] - MONTH_S), k - FEWEST_BESIDE)
    end = np.maximum(np.searchsorted(time_unix, time_unix[np.maximum(k - 1, 0)] + MONTH_S), k + FEWEST_BESIDE)
    begin, end = np.maximum(begin, 0), np.minimum(end, k[-1])
    sides = [
        (count[..., high] - count[..., low], total[..., high] - total[..., low]) for low, high in ((begin, k), (k, end))
    ]
    means = [np.where(number >= FEWEST_BESIDE, sums / np.maximum(number, 1), np.nan) for number, sums in sides]
    share = sum(1.0 / np.maximum(number, 1) for number, _ in sides)
    scatter = spread(np.diff(values, axis=-1), axis=-1)[..., None] / 2**0.5
    of_median = np.median(np.nan_to_num(means[1] - means[0]), axis=0)  # which steps where many do
    return means[0], means[1] - of_median, np.hypot(scatter * share**0.5, SMALLEST_SPREAD)


def _odds_of_step(before: Floats, after: Floats, error: Floats) -> Floats:
    """Log odds of a step of each antenna at each split, shape (antenna, split)."""
    return np.asarray(0.5 * np.nansum(((after - before) / error) ** 2, axis=1))


def _list_cycles(place: NDArray[np.int64]) -> Iterator[list[int]]:
    """The circles of a permutation, without those that stay where they are."""
    left = set(range(place.size))
    while left:
        cycle = [left.pop()]
        while (following := int(place[cycle[-1]])) in left:
            left.remove(following)
            cycle.append(following)
        if len(cycle) > 1:
            yield cycle


def _tell(station: AuditedStation, one: Circle) -> Line:
    numbers = station.antennas[list(one.rows)].tolist()
    dipole = None if len(one.dipoles) == len(station.dipoles) else station.dipoles[one.dipoles[0]]
    which = "" if dipole is None else f"{dipole} of "
    *first, last = map(str, numbers)
    when = f"since {one.since}" + ("" if one.until is None else f" and until {one.until}")
    return Line(
        MOVED,
        WRONG,
        station.name,
        f"{which}antennas {', '.join(first)} and {last} change places {when}",
        antennas=tuple(numbers),
        dipole=dipole,
        log_odds=one.odds,
        kind=MOVED,
        since_unix=one.since.at,
        until_unix=None if one.until is None else one.until.at,
    )
