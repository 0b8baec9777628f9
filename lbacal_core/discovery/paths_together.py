"""What paths show together: each departs too little to be seen alone, but all depart in one way.

A shadow over a field of 48 antennas tilts each path along LST by one or two standard deviations. The scores of all
paths for smooth functions of an axis, each in units of its noise and less the mean of its class, make a matrix of
normal numbers, shape (path, function). A common pattern with an amplitude of each path is a matrix of rank one, which
raises the largest eigenvalue; that of noise has a known law.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc

from lbacal_core.discovery.levels import beyond_noise
from lbacal_core.grids import Floats

SMALLEST = 1e-6
"""Information, relative to the largest, below which a function is a combination of the others."""
SHAPE, SCALE, SHIFT = 46.446, 0.186054, 9.84801
"""Gamma law that is the law of Tracy and Widom to some per cent of a probability (Chiani 2014, J. Multivar. Anal. 129,
69, table 1)."""


def depart(score: Floats, information: Floats) -> tuple[Floats, float]:
    """Scores of the paths of one class less their mean, in units of their noise.

    Paths of one class (a cable name and a polarisation) show the sky and the gains of the station alike: a sky that
    no model has leaves a pattern in the classes, and none in the departures of paths from their class.

    Parameters
    ----------
    score, information
        Shape (path, function) and (path, function, function).

    Returns
    -------
    The same shape as the scores, whitened by the symmetric root, so that paths which are alike keep a pattern alike;
    and how many functions a path tells apart, the mean of all.
    """
    if not len(score):
        return score, 0.0
    roots, told_apart = _roots(information)
    white = np.einsum("pij,pj->pi", roots, score)
    return white - white.mean(axis=0), float(told_apart.mean())


def chance_of_pattern(white: Floats, independent: float, functions: float) -> tuple[float, float, Floats]:
    """Probability by chance of the strongest common pattern in whitened scores, shape (path, function).

    Parameters
    ----------
    independent
        Number of independent rows: departures from a mean lose one.
    functions
        Number of functions that a path tells apart.

    Returns
    -------
    The probability, the chi^2 gained by the pattern, and the amplitude of each path, shape (path,).
    """
    left, sizes, _ = np.linalg.svd(white, full_matrices=False)
    gain = float(sizes[0] ** 2)
    beyond = beyond_noise(gain, independent, functions)
    return float(gammaincc(SHAPE, max(beyond + SHIFT, 0.0) / SCALE)), gain, left[:, 0] * sizes[0]


def fit_pattern(score: Floats, information: Floats) -> Floats:
    """Sizes of the functions in each path by the strongest common pattern, (path, function).

    With a single path they are those of least squares.
    """
    roots, _ = _roots(information)
    white = np.einsum("pij,pj->pi", roots, score)
    pattern = np.linalg.svd(white, full_matrices=False)[2][0]
    return np.asarray((white @ pattern)[:, None] * (roots @ pattern))


def _roots(information: Floats) -> tuple[Floats, Floats]:
    """Symmetric roots of the inverse on the space that the functions span, and its dimension, of each path."""
    values, vectors = np.linalg.eigh(information)
    is_own = values > SMALLEST * np.maximum(values[:, -1:], 1e-300)
    inverse = np.where(is_own, values, np.inf) ** -0.5
    return vectors * inverse[:, None, :] @ np.swapaxes(vectors, 1, 2), is_own.sum(axis=1).astype(float)
