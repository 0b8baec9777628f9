"""What chance does: probabilities of scores, and how many independent scores correlated ones are worth."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc, erfcinv

from lbacal_core.grids import Floats

DRAWS = 2000


def p_of(z: float, trials: float) -> float:
    """Probability that the largest of `trials` independent standard normal numbers exceeds z in absolute value."""
    return float(-np.expm1(-trials * erfc(z / np.sqrt(2.0))))


def significance(z: float, trials: float) -> float:
    """The score as a normal number after the look-elsewhere correction, however small the probability."""
    p_value = p_of(z, trials)
    return sigma_of(p_value) if p_value > 1e-250 else float(np.sqrt(z**2 - 2 * np.log(trials)))


def sigma_of(p_value: float) -> float:
    """The two-sided normal equivalent of a probability, standard deviations."""
    return float(np.sqrt(2.0) * erfcinv(np.clip(p_value, 1e-300, 1.0)))


def equivalent_trials(correlation: Floats, seed: int) -> float:
    """Equivalent number of independent scores of correlated ones, shape (score, score).

    From the 90 % quantile of simulated largest scores, where they are many and the tail has begun.
    """
    if len(correlation) == 1:
        return 1.0
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(seed).standard_normal((DRAWS, root.shape[1])) @ root.T
    quantile = float(np.quantile(np.abs(draws).max(axis=1), 0.9))
    return float(max(-np.log(0.9) / max(float(erfc(quantile / np.sqrt(2.0))), 1e-300), 1.0))
