"""Whether neighbouring events are alike: the noise of an event has no memory, bursts and weather last for hours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from numpy.typing import NDArray
from scipy.special import gammaln

from lbacal_core.discovery.levels import clean_mean, profiles_of_axes
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

WITHIN_S = 3 * 3600.0
"""Time between events that count as neighbours: bursts of Jupiter and thunderstorms last for hours."""
FEWEST_PAIRS = 100
"""Pairs of neighbours from which their products are normal: events that come in runs have 500 of 900 events."""
LARGEST = 4.0
"""Standard deviations at which amounts are cut, so that no event decides alone."""
OWN_SHARE = 0.3
"""Size, relative to the largest, below which a smooth function is a combination of the vectors and of the others."""
FURTHEST, STEPS = 6.0, 601
"""Range beyond an eigenvalue, and its steps, over which the density is added up: what lies further is nothing."""


@dataclass(frozen=True)
class Memory:
    """How alike neighbouring events are.

    Attributes
    ----------
    p_value
        Probability by chance.
    spectrum
        Along which they are alike most, whitened, of length 1, shape (freq,).
    """

    p_value: float
    spectrum: Floats


@dataclass(frozen=True)
class _Neighbours:
    """Neighbours among events in the order of time, as a matrix P that is 1/2 for two of them and 0 elsewhere.

    Attributes
    ----------
    first, last
        The first neighbour of an event and the one behind the last, shape (event,).
    """

    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def of(cls, time: Floats) -> _Neighbours:
        """Events less than `WITHIN_S` apart."""
        return cls(np.searchsorted(time, time - WITHIN_S, side="right"), np.searchsorted(time, time + WITHIN_S))

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


def find_memory(station: Station, white: Floats, vectors: Floats, smooth: Floats) -> Memory | None:
    """Compare events with their neighbours, along the vectors of the noise and along smooth functions of frequency.

    What follows an axis of the data is taken out before: along an axis all structure lasts. What is left of independent
    events is a little unlike in neighbours, which is accounted for. Sums of the products of two amounts over all pairs
    make a symmetric matrix of nearly normal numbers, whose largest eigenvalue is tested.

    Parameters
    ----------
    white
        Whitened means, shape (event, freq).
    vectors
        Vectors of the noise, orthonormal, shape (k, freq).
    smooth
        Shape (function, freq).

    Returns
    -------
    None where too few events have neighbours.
    """
    order = np.argsort(station.conditions.time_unix)
    neighbours = _Neighbours.of(station.conditions.time_unix[order])
    if not station.conditions.has_dates or neighbours.pairs < FEWEST_PAIRS:
        return None
    _, sizes, beside = np.linalg.svd(smooth - smooth @ vectors.T @ vectors, full_matrices=False)
    basis = np.concatenate([vectors, beside[sizes > OWN_SHARE * sizes[0]]])
    amount = clean_mean(station, white[None], vectors)[0][order] @ basis.T
    values, turned = np.linalg.eigh(np.cov(amount.T))
    amount = np.clip((amount - amount.mean(axis=0)) @ turned / np.sqrt(values), -LARGEST, LARGEST)
    profiles = profiles_of_axes(station)[order]
    amount -= profiles @ (profiles.T @ amount)
    amount /= np.sqrt(np.sum(amount**2, axis=0) / (len(amount) - profiles.shape[1]))
    mean, variance, skewness = neighbours.cumulants(profiles)
    together = amount.T @ neighbours.next_to(amount) - mean * np.eye(len(basis))
    sizes, directions = np.linalg.eigh(together / variance**0.5)
    largest = float(sizes[-1])
    spectrum = turned @ (np.sqrt(values) * directions[:, -1]) @ basis
    normal = largest - skewness / 6.0 * (largest**2 - 1.0)  # Cornish & Fisher 1938, Rev. Int. Stat. Inst. 5, 307
    return Memory(chance_of(normal, len(basis)), spectrum / np.linalg.norm(spectrum))


def chance_of(largest: float, size: int) -> float:
    """Probability of the largest eigenvalue of a symmetric matrix of normal numbers, of variance 1 on the diagonal.

    It is the expected number of eigenvalues beyond, whose density is the normal one times the expected determinant of
    the matrix of the others, a Hermite polynomial (Mehta 2004, Random Matrices, chapter 7); 1 within the edge.
    """
    if largest < (2.0 * size) ** 0.5:
        return 1.0
    log_factor = gammaln(1.5) - gammaln(1.0 + 0.5 * size) - 0.5 * (size - 1) * np.log(2.0)
    factor = size * np.exp(log_factor) / (2.0 * np.pi) ** 0.5
    beyond = largest + np.linspace(0.0, FURTHEST, STEPS)
    density = np.exp(-0.5 * beyond**2) * hermeval(2.0**0.5 * beyond, np.eye(size)[-1])
    return float(min(factor * np.trapezoid(density, beyond), 1.0))
