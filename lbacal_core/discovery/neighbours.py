"""Events that follow on one another within some time, and how alike they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

FEWEST_PAIRS = 100
"""Pairs of neighbours from which their products are normal: events that come in runs have 500 of 900 events."""


@dataclass(frozen=True)
class Neighbours:
    """Neighbours among events in the order of time, as a matrix P that is 1/2 for two of them and 0 elsewhere.

    Attributes
    ----------
    first, last
        The first neighbour of an event and the one behind the last, shape (event,).
    """

    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def of(cls, time: Floats, within: float) -> Neighbours:
        """Make those of events less than so many seconds apart, of times that rise, shape (event,)."""
        return cls(np.searchsorted(time, time - within, side="right"), np.searchsorted(time, time + within))

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return int(np.sum(self.last - self.first - 1)) // 2

    def next_to(self, values: Floats) -> Floats:
        """P times values, shape (event, any)."""
        summed = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        return np.asarray((summed[self.last] - summed[self.first] - values) / 2.0)

    def cumulants(self, profiles: Floats) -> tuple[float, float, float]:
        """Mean, variance and skewness of x'MPMx for normal numbers x, where M takes orthonormal profiles out.

        They are tr Q, 2 tr Q^2 and 8 tr Q^3 / (2 tr Q^2)^1.5 of Q = MPM (Mathai & Provost 1992, Quadratic Forms in
        Random Variables, 3.2b). The size of x is estimated from the n numbers that are free, which takes
        (tr Q)^2 / n from tr Q^2.
        """
        near = self.next_to(profiles)
        inside, squared = profiles.T @ near, near.T @ near
        ahead = self.last - np.arange(self.last.size) - 1
        triples = float(np.sum(ahead * (ahead - 1))) / 2.0
        mean = -float(np.trace(inside))
        square = self.pairs / 2.0 - 2.0 * float(np.trace(squared)) + float(np.sum(inside**2))
        cube = 0.75 * triples - 3.0 * float(np.sum(near * self.next_to(near)))
        cube += 3.0 * float(np.sum(inside * squared)) - float(np.sum((inside @ inside) * inside))
        variance = 2.0 * (square - mean**2 / (self.last.size - profiles.shape[1]))
        return mean, variance, 8.0 * cube / variance**1.5
