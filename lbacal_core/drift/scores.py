"""How much a step at any month, or a slope, would explain beside the terms that series have: score tests.

For a candidate column h the residual r of the fit gives the size (h W r) / (h W h - b^T S b), with b = Z^T W h and S
the covariance of the fit: what the fit describes of h is profiled out. A step's column is 1 from its month on, so that
all its products are sums over the end of a series, and all months are scored at once.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, chdtri, ndtri

from lbacal_core.drift.terms import Fit
from lbacal_core.grids import Floats

_NOTHING = 1e-12
_SMALLEST_P = 1e-250


def score_steps(inverse: Floats, columns: Floats, fit: Fit, whitener: Floats) -> Floats:
    """Chi-square of a step before every month, shape (series, month); arguments as in `terms.fit_terms`."""
    after = np.cumsum((inverse @ columns)[:, :, ::-1], axis=2)[:, :, ::-1]
    sums = np.cumsum(np.cumsum(inverse[:, :, ::-1, ::-1], axis=2), axis=3)
    information = np.diagonal(sums, axis1=2, axis2=3)[:, :, ::-1]
    described = np.sum((after @ fit.covariance) * after, axis=-1)
    score = np.cumsum(fit.weighted_residual[:, :, ::-1], axis=2)[:, :, ::-1]
    information = np.maximum(information - described, _NOTHING)
    return chi_square(whitener, score / information, 1.0 / information)


def score_slope(inverse: Floats, columns: Floats, fit: Fit, whitener: Floats, slope: Floats) -> Floats:
    """Chi-square of a slope, shape (series,); `slope` is its column, shape (month,)."""
    weighted = inverse @ slope
    beside = (weighted[:, :, None, :] @ columns)[:, :, 0]
    described = np.sum((beside[:, :, None, :] @ fit.covariance)[:, :, 0] * beside, axis=-1)
    information = np.maximum(weighted @ slope - described, _NOTHING)
    return chi_square(whitener, (fit.weighted_residual @ slope) / information, 1.0 / information)


def chi_square(whitener: Floats, size: Floats, variance: Floats) -> Floats:
    """Chi-square of sizes, shape (mode, ...), the modes made uncorrelated."""
    z = np.tensordot(whitener, size / np.sqrt(np.maximum(variance, 1e-300)), axes=1)
    return np.asarray(np.sum(z**2, axis=0))


def find_significance(chi2: Floats, modes: int) -> Floats:
    """Standard deviations of a normal with the same probability on both sides; a very large chi-square's root."""
    p = chdtrc(modes, chi2)
    return np.asarray(np.where(p > _SMALLEST_P, -ndtri(np.maximum(p, _SMALLEST_P) / 2.0), np.sqrt(chi2)))


def find_threshold(false_alarms: float, trials: int, modes: int) -> float:
    """The chi-square that so many trials exceed by chance in `false_alarms` of all cases."""
    return float(chdtri(modes, false_alarms / max(trials, 1)))
