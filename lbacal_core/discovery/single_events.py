"""Structure in single events: in many, in a few, on one side of zero in some, or alike in neighbours.

It uses no axis. The means are whitened, both polarisations together, and what is free is taken out of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from scipy.special import bdtrc, chdtrc, gammaln

from lbacal_core.discovery.hypothesis import p_of_best
from lbacal_core.discovery.neighbours import FEWEST_PAIRS, Neighbours
from lbacal_core.discovery.noise import LINE, clean_mean, is_heavy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.station import Station
from lbacal_core.errors import SMALLEST_CHANCE
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric

# Whether neighbouring events are alike: the noise of an event has no memory, bursts and weather last for hours.

WITHIN_S = 3 * 3600.0
"""Time between events that count as neighbours: bursts of Jupiter and thunderstorms last for hours."""
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
    None where too few events have neighbours, or the axes of the data leave nothing of them.
    """
    order = np.argsort(station.conditions.time_unix)
    neighbours = Neighbours.of(station.conditions.time_unix[order], WITHIN_S)
    if not station.conditions.has_dates or neighbours.pairs < FEWEST_PAIRS:
        return None
    _, sizes, beside = np.linalg.svd(smooth - smooth @ vectors.T @ vectors, full_matrices=False)
    basis = np.concatenate([vectors, beside[sizes > OWN_SHARE * sizes[0]]])
    amount = clean_mean(station, white[None], vectors)[0][order] @ basis.T
    values, turned = np.linalg.eigh(np.cov(amount.T))
    amount = np.clip((amount - amount.mean(axis=0)) @ turned / np.sqrt(values), -LARGEST, LARGEST)
    profiles = station.profiles_of_axes[order]
    amount -= profiles @ (profiles.T @ amount)
    left, freedom = np.sum(amount**2, axis=0), len(amount) - profiles.shape[1]
    if freedom <= 0 or np.any(left <= SMALLEST_TOTAL):
        return None
    amount /= np.sqrt(left / freedom)
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


NOISE_DRAWS = 60
"""Draws of noise for the largest singular value: they give its mean to 13 % and its spread to 9 % of the spread."""
TAIL = 0.8
"""Units s of the tail exp(-2/3 s^1.5) in one spread of the simulated largest eigenvalue. The Tracy-Widom distribution
of order 1 (Johnstone 2001, Ann. Stat. 29, 295) has s = 1.27 x - 1.21 at x spreads: 0.8 x is careful beyond x = 2.6."""
ORDINARY = 0.01
"""Share of events far outside the noise that is no structure: interference that was left, in drawn worlds 0.7 %."""
SMALLEST_TOTAL = 1e-6
"""Floor of the sum of squares of the noise: exact data have none."""


@dataclass(frozen=True)
class InEvents:
    """Structure in single events.

    Attributes
    ----------
    p_value
        Probability by chance.
    gain, dof
        Largest eigenvalue beyond that of noise, and the events and channels that it is of.
    spectrum
        Along which it is, whitened, of length 1, shape (freq,).
    """

    p_value: float
    gain: float
    dof: int
    spectrum: Floats


def find_in_events(model: LinearModel, smooth: Floats, rng: np.random.Generator) -> InEvents:
    """The strongest structure in single events.

    The largest singular value of the whitened events x channels matrix of the means stands for the first, outside the
    vectors of the noise: a vector that is off by a few per cent makes what lies beside it go with its amounts, which
    was told as structure in 2 of 216 worlds. Where structure lies along the vectors, the number of events far outside
    the noise stands for the second, and the skewness of the others (Mardia 1970, Biometrika 57, 519) for the third:
    noise has no preferred sign.

    Parameters
    ----------
    smooth
        Smooth functions of frequency, shape (function, freq).
    """
    white = _whiten(model, model.residuals.mean)
    vectors, kind_of = model.common.vectors, model.residuals.levels.kind_of
    vectors = vectors[np.any(vectors != 0, axis=1)]
    cut = np.clip(white, -LINE, LINE)
    rest, channels = cut - cut @ vectors.T @ vectors, max(white.shape[1] - len(vectors), 1)
    right = np.linalg.svd(cut, full_matrices=False)[2]
    noise = np.array([_largest_of_noise(rng, len(white), channels) for _ in range(NOISE_DRAWS)])
    # Scaled to the total of the noise, so that a wrong noise level does not look like structure.
    of_noise = max(float(np.sum(rest**2)), SMALLEST_TOTAL) / (len(rest) * channels)
    observed = np.linalg.svd(rest, compute_uv=False)[0] ** 2 / of_noise
    mean, spread = float(noise.mean()), float(noise.std())
    excess = max((observed - mean) / spread, 0.0)
    in_many = float(min(np.exp(-2.0 / 3.0 * (TAIL * excess) ** 1.5), 1.0))
    amount = white @ vectors.T
    is_far = np.zeros(len(white), dtype=bool)
    for kind in range(kind_of.max() + 1):
        is_far[kind_of == kind] = is_heavy(amount[kind_of == kind])
    in_few = float(bdtrc(is_far.sum() - 1, is_far.size, ORDINARY))
    on_one_side = _chance_of_skewness(cut[~is_far] @ vectors.T)
    spectrum = right[0] if in_many <= min(in_few, on_one_side) else np.sum(amount**2, axis=1) @ amount @ vectors
    chances = [in_many, p_of_best(min(in_few, on_one_side), 2)]
    if (memory := find_memory(model.station, cut, vectors, smooth)) is not None:
        spectrum = memory.spectrum if memory.p_value < min(chances) else spectrum
        chances.append(memory.p_value)
    return InEvents(
        _chance_together(chances), float(observed - mean), len(white) + channels, spectrum / np.linalg.norm(spectrum)
    )


def _chance_together(chances: Sequence[float]) -> float:
    """Probability by chance of independent tests, of which one may see structure, or each a little.

    That of the best and that of the product of all (Fisher 1925, Statistical Methods for Research Workers, 21.1) are
    two tests: storms that were on one side with 4 in 10,000 and alike in neighbours with 3 in 100,000 were silent.
    """
    of_product = float(chdtrc(2 * len(chances), -2.0 * np.sum(np.log(np.maximum(chances, SMALLEST_CHANCE)))))
    return p_of_best(min(p_of_best(min(chances), len(chances)), of_product), 2)


def _chance_of_skewness(amount: Floats) -> float:
    """Probability by chance of the skewness of amounts, shape (event, k)."""
    events, size = amount.shape
    centred = amount - amount.mean(axis=0)
    skewness = np.sum((centred @ invert_symmetric(centred.T @ centred / events) @ centred.T) ** 3) / events**2
    return float(chdtrc(size * (size + 1) * (size + 2) / 6, events * skewness / 6.0))


def _largest_of_noise(rng: np.random.Generator, events: int, channels: int) -> float:
    noise = rng.standard_normal((events, channels))
    return float(np.linalg.eigvalsh(noise.T @ noise)[-1])


def pattern_of(model: LinearModel, spectrum: Floats) -> Floats:
    """What every event has along a whitened spectrum, in the means, shape (1, polarisation, event, freq)."""
    pattern = np.outer(_whiten(model, model.residuals.mean) @ spectrum, spectrum)
    vectors, channel = model.common.vectors, model.common.channel
    amount = pattern @ vectors.T
    outside = (pattern - amount @ vectors) / np.sqrt(np.maximum(channel, 1e-300))[..., None]
    inside = np.squeeze(invert_symmetric(_root_of_inside(model)) @ amount[..., None], -1) @ vectors
    return np.asarray((outside + inside) * (channel > 0)[..., None])[None]


def _whiten(model: LinearModel, values: Floats) -> Floats:
    """A vector of the means without what is free, both polarisations together, in standard deviations."""
    view = model.common
    clean = view.clean(values)
    amount = clean @ view.vectors.T
    outside = (clean - amount @ view.vectors) * np.sqrt(view.channel)[..., None]
    inside = np.squeeze(_root_of_inside(model) @ amount.sum(axis=0)[..., None], -1) @ view.vectors
    return np.asarray((outside.sum(axis=0) + inside) / np.sqrt(len(clean)))


def _root_of_inside(model: LinearModel) -> Floats:
    """Root of the inverse covariance of the sum of both polarisations along the noise's vectors, (event, k, k)."""
    inside = model.common.inside
    values, turned = np.linalg.eigh(inside.sum(axis=(0, 1)) / len(inside))
    return np.asarray((turned * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(turned, 1, 2))
