"""The noise of the points of an LST curve, from their scatter about a smooth curve: smaller than drawn bars may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.linear import fit_least_squares
from lbacal_core.lstcurve.curve import LstCurve

SMOOTH_HARMONICS = 6
"""Harmonics of the smooth curve whose residuals estimate the noise of the points: the sky has fewer (|m| <= 4)."""
FEWEST_FREE = 5
"""Degrees of freedom below which a point noise is not worth stating (32 % uncertain)."""
LARGEST_CORRELATION = 0.99
"""Beyond, the difference of the dipoles would count as nearly free of noise because of a few points."""


@dataclass(frozen=True)
class PointNoise:
    """Noise of the points of both dipoles.

    The mean of an LST bin is over the same events for both dipoles, whose common gain fluctuates: what they share
    leaves their difference more precise than either.

    Attributes
    ----------
    sigma_db
        By dipole, dB.
    correlation
        Between the dipoles at one LST.
    free
        Degrees of freedom from which the level is known.
    """

    sigma_db: dict[str, float]
    correlation: float
    free: int

    def covariance(self, curve: LstCurve) -> Floats:
        """Covariance of the points, X then Y, those that exist; dB^2, shape (point, point)."""
        place = [np.flatnonzero(curve.has_point(dipole)) for dipole in DIPOLES]
        sigma = np.concatenate([np.full(at.size, self.sigma_db[d]) for d, at in zip(DIPOLES, place, strict=True)])
        index = np.concatenate(place)
        shared = np.where(index[:, None] == index[None, :], self.correlation, 0.0)
        np.fill_diagonal(shared, 1.0)
        return np.asarray(sigma[:, None] * shared * sigma[None, :])


def estimate_noise(curve: LstCurve, harmonics: int = SMOOTH_HARMONICS) -> PointNoise:
    """Estimate the noise of both dipoles and what they share."""
    left = {dipole: _about_smooth(curve, dipole, harmonics) for dipole in DIPOLES}
    free = {dipole: int(curve.has_point(dipole).sum()) - 1 - 2 * harmonics for dipole in DIPOLES}
    if min(free.values()) < FEWEST_FREE:
        needed = f"{1 + 2 * harmonics + FEWEST_FREE} points or more a dipole to estimate their noise"
        raise BadInputError(curve.origin, needed, f"{min(free.values()) + 1 + 2 * harmonics}")
    sigma = {dipole: float(np.sqrt(np.nansum(left[dipole] ** 2) / free[dipole])) for dipole in DIPOLES}
    both = np.isfinite(left["X"]) & np.isfinite(left["Y"])
    x, y = left["X"][both], left["Y"][both]
    correlation = float(x @ y / np.sqrt((x @ x) * (y @ y)))
    limited = float(np.clip(correlation, -LARGEST_CORRELATION, LARGEST_CORRELATION))
    return PointNoise(sigma, limited, sum(free.values()))


def estimate_point_noise(curve: LstCurve, dipole: str) -> float | None:
    """Scatter of the points of one dipole about a smooth curve, dB; None with too few points."""
    free = int(curve.has_point(dipole).sum()) - 1 - 2 * SMOOTH_HARMONICS
    if free < FEWEST_FREE:
        return None
    left = _about_smooth(curve, dipole, SMOOTH_HARMONICS)
    return float(np.sqrt(np.nansum(left**2) / free))


def _about_smooth(curve: LstCurve, dipole: str, harmonics: int) -> Floats:
    """Measured minus the Fourier series that fits best, shape (point,), NaN where there is no point."""
    has_point = curve.has_point(dipole)
    angle = 2 * np.pi / 24.0 * np.outer(curve.lst_hours[has_point], np.arange(1, harmonics + 1))
    design = np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)
    measured = curve.variation_db[dipole][has_point]
    left = np.full(curve.lst_hours.shape, np.nan)
    left[has_point] = measured - design @ fit_least_squares(design, measured)
    return left
