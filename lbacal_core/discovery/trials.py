"""Look-elsewhere: probabilities of the largest of many scores, and the trials factor of correlated ones."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc, erfcinv

from lbacal_core.grids import Floats

DRAWS = 2000
"""Simulated sets of scores: the quantile below is then known to 7 % of its trials factor."""
QUANTILE = 0.9
"""Quantile of the largest score that gives the trials factor: its tail has begun there, and 200 draws lie beyond."""

LARGEST_LEVEL = 8.0
"""Level beyond which the trials factor hardly changes a significance, standard deviations."""

SMALLEST_EIGENVALUE = 1e-9
"""Smallest eigenvalue over the largest: below, it is a rounding error, whose root would be seen."""


def p_of(z: float, trials: float) -> float:
    """Probability that the largest of `trials` independent standard normal numbers exceeds z in absolute value."""
    return float(-np.expm1(-trials * erfc(z / np.sqrt(2.0))))


def p_of_best(p_value: float, trials: float) -> float:
    """Probability that the smallest of `trials` independent p-values is as small (Sidak 1967)."""
    return float(-np.expm1(trials * np.log1p(-min(p_value, 1 - 1e-12))))


def significance(z: float, trials: float) -> float:
    """The score in standard deviations after the look-elsewhere correction, however small the probability."""
    p_value = p_of(z, trials)
    return sigma_of(p_value) if p_value > 1e-250 else float(np.sqrt(z**2 - 2 * np.log(trials)))


def sigma_of(p_value: float) -> float:
    """The two-sided normal equivalent of a probability, standard deviations."""
    return float(np.sqrt(2.0) * erfcinv(np.clip(p_value, 1e-300, 1.0)))


def trials_factor(correlation: Floats, seed: int, level: float = 0.0) -> float:
    """Number of independent scores whose largest exceeds as much as that of correlated ones, shape (score, score).

    It grows with the level: neighbouring dates that are one trial at 3 sigma are two or three at 5. Beyond what drawn
    scores reach, one score is drawn beyond the level and the others beside it; the probability that any exceeds is the
    mean of 1 over the number that do, times that of each alone (Adler, Blanchet & Liu 2012, Ann. Appl. Prob. 22, 1167).

    Parameters
    ----------
    level
        Score in standard deviations at which the number is asked; that of the quantile `QUANTILE` at least.
    """
    if len(correlation) == 1:
        return 1.0
    values, vectors = np.linalg.eigh(correlation)
    # The symmetric root without rounding errors: any other depends on the last digits of the matrix.
    root = (vectors * np.sqrt(np.where(values > SMALLEST_EIGENVALUE * values[-1], values, 0.0))) @ vectors.T
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((DRAWS, len(root))) @ root
    quantile = float(np.quantile(np.abs(draws).max(axis=1), QUANTILE))
    if level <= quantile:
        return float(max(-np.log(QUANTILE) / max(float(erfc(quantile / np.sqrt(2.0))), 1e-300), 1.0))
    seen = np.flatnonzero(np.diag(correlation) > SMALLEST_EIGENVALUE)
    tail, at = float(erfc(min(level, LARGEST_LEVEL) / np.sqrt(2.0))), np.arange(DRAWS)
    first = rng.choice(seen, DRAWS)
    beyond = np.sqrt(2.0) * erfcinv(tail * (1.0 - rng.random(DRAWS)))
    draws += (beyond - draws[at, first])[:, None] * correlation[first]
    draws[at, first] = beyond
    many = np.sum(np.abs(draws) >= np.minimum(beyond, min(level, LARGEST_LEVEL))[:, None], axis=1)
    chance = min(seen.size * tail * float(np.mean(1.0 / many)), QUANTILE)
    return float(max(-np.log1p(-chance) / tail, 1.0))
