"""Antennas that change places on a date: from then on each records what the other did before."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.antennas import CERTAIN, DATE_SIGMA, FEWEST_BESIDE, OUTLYING, SMALLEST_SPREAD, find_edge
from lbacal_core.audit.station import AuditedStation, spread
from lbacal_core.audit.verdict import WRONG, Line
from lbacal_core.grids import Floats

MOVED = "antennas exchanged"


def find_moved(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """Pairs of antennas, among these rows, of which each has the level and slope of the other since a date.

    Both are those of ln P along frequency over the median antenna's, which does not care who is who. That they change
    places is held against no change, and against steps of any size, to the factor of an outlying path, of both.
    """
    power = np.log(station.power[rows])
    power = power - np.nanmedian(power, axis=0)
    along = np.linspace(-0.5, 0.5, power.shape[-1])
    level, slope = power.mean(axis=-1), (power * along).sum(axis=-1) / np.sum(along**2)
    seen = np.concatenate([level, slope], axis=1)  # (antenna, level and slope of each dipole, time)
    known = np.isfinite(seen).all(axis=1)
    stepped = [a for a in range(rows.size) if _odds_of_steps(seen[a][:, known[a]])[0].max(initial=0.0) > CERTAIN]
    found = []
    for a, b in combinations(stepped, 2):
        both = np.flatnonzero(known[a] & known[b])
        one, other = seen[a][:, both], seen[b][:, both]
        odds, splits, scatter = _odds_of_steps(one - other)
        if splits.size == 0:
            continue
        k = int(np.argmax(odds))
        is_late = np.arange(both.size) >= splits[k]
        error = np.hypot(scatter * (1 / np.sum(is_late) + 1 / np.sum(~is_late)) ** 0.5, SMALLEST_SPREAD)
        was, became = (np.stack([y[:, own].mean(axis=1) for y in (one, other)]) for own in (~is_late, is_late))
        steps, misses = became - was, became - was[::-1]
        chance = np.log(splits.size * rows.size * (rows.size - 1) / 2)
        over_none = 0.5 * np.sum((steps**2 - misses**2) / error**2) - chance
        over_steps = np.sum(np.log(OUTLYING / error) - 0.5 * (misses / error) ** 2) - np.log(rows.size - 1)
        if min(over_none, over_steps) > CERTAIN:
            edge = find_edge(station.time_unix[both], splits[k], splits[odds >= odds[k] - DATE_SIGMA**2 / 2])
            antennas = (int(station.antennas[rows[a]]), int(station.antennas[rows[b]]))
            sentence = f"antennas {antennas[0]} and {antennas[1]} change places since {edge}"
            gain = float(min(over_none, over_steps))
            line = Line(MOVED, WRONG, station.name, sentence, antennas, None, gain, kind=MOVED, since_unix=edge.at)
            found.append(line)
    return found


def _odds_of_steps(values: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Log odds of a step of values of shape (value, time) by the number of instants before it, that, and scatter."""
    total, count = np.cumsum(values, axis=1), values.shape[1]
    splits = np.arange(FEWEST_BESIDE, count - FEWEST_BESIDE + 1)
    before, after = total[:, splits - 1] / splits, (total[:, -1:] - total[:, splits - 1]) / (count - splits)
    scatter = spread(np.diff(values, axis=1), axis=1) / 2**0.5
    variance = scatter[:, None] ** 2 * (1 / splits + 1 / (count - splits)) + SMALLEST_SPREAD**2
    return np.asarray(0.5 * np.sum((after - before) ** 2 / variance, axis=0)), splits, scatter
