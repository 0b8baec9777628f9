"""Whether neighbouring events are alike: the noise of an event has no memory, bursts and weather last for hours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from scipy.special import gammaln

from lbacal_core.discovery.levels import clean_mean
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


def find_memory(station: Station, white: Floats, vectors: Floats, smooth: Floats) -> Memory | None:
    """Compare events with their neighbours, along the vectors of the noise and along smooth functions of frequency.

    The products of the amounts of two events have mean 0 and variance 1 where the events are independent. Their sums
    over all pairs of neighbours make a symmetric matrix of normal numbers, whose largest eigenvalue is tested. What
    follows an axis of the data is taken out before: along an axis all structure lasts.

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
    time = station.conditions.time_unix[order]
    last = np.searchsorted(time, time + WITHIN_S)
    after = np.arange(time.size) + 1
    pairs = int(np.sum(last - after))
    if not station.conditions.has_dates or pairs < FEWEST_PAIRS:
        return None
    _, sizes, beside = np.linalg.svd(smooth - smooth @ vectors.T @ vectors, full_matrices=False)
    basis = np.concatenate([vectors, beside[sizes > OWN_SHARE * sizes[0]]])
    amount = clean_mean(station, white[None], vectors)[0][order] @ basis.T
    values, turned = np.linalg.eigh(np.cov(amount.T))
    amount = np.clip((amount - amount.mean(axis=0)) @ turned / np.sqrt(values), -LARGEST, LARGEST)
    amount /= amount.std(axis=0)
    summed = np.concatenate([np.zeros((1, len(basis))), np.cumsum(amount, axis=0)])
    together = amount.T @ (summed[last] - summed[after]) / pairs**0.5
    sizes, directions = np.linalg.eigh((together + together.T) / 2)
    spectrum = turned @ (np.sqrt(values) * directions[:, -1]) @ basis
    return Memory(chance_of(float(sizes[-1]), len(basis)), spectrum / np.linalg.norm(spectrum))


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
