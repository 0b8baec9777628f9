"""Look-elsewhere: probabilities of the largest of many scores, and the trials factor of correlated ones."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc, erfcinv

from lbacal_core.grids import Floats

DRAWS = 2000
"""Simulated sets of scores: the quantile below is then known to 7 % of its trials factor."""
QUANTILE = 0.9
"""Quantile of the largest score that gives the trials factor: its tail has begun there, and 200 draws lie beyond."""

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


def trials_factor(correlation: Floats, seed: int) -> float:
    """Number of independent scores whose largest exceeds as much as that of correlated ones, shape (score, score)."""
    if len(correlation) == 1:
        return 1.0
    values, vectors = np.linalg.eigh(correlation)
    # The symmetric root without rounding errors: any other depends on the last digits of the matrix.
    root = (vectors * np.sqrt(np.where(values > SMALLEST_EIGENVALUE * values[-1], values, 0.0))) @ vectors.T
    draws = np.random.default_rng(seed).standard_normal((DRAWS, len(root))) @ root
    quantile = float(np.quantile(np.abs(draws).max(axis=1), QUANTILE))
    return float(max(-np.log(QUANTILE) / max(float(erfc(quantile / np.sqrt(2.0))), 1e-300), 1.0))
