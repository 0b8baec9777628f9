"""The probability of detection against the ideal SNR, fitted to single trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr, ndtr, ndtri

from lbacal_core.grids import Floats


@dataclass(frozen=True)
class DetectionCurve:
    """P(detected) = Phi((SNR - snr_50) / width), fitted to single trials.

    Attributes
    ----------
    snr_50, width
        The fit.
    draws
        (snr_50, width) of refits to trials drawn again from the fit, shape (draw, 2).
    """

    snr_50: float
    width: float
    draws: Floats

    def snr_at(self, probability: float) -> float:
        """The SNR that is detected with a probability."""
        return float(self.snr_50 + ndtri(probability) * self.width)

    def bounds(self, probability: float, confidence: float) -> tuple[float, float]:
        """The interval of that SNR."""
        draws = self.draws[:, 0] + ndtri(probability) * self.draws[:, 1]
        low, high = np.quantile(draws, [0.5 - confidence / 2, 0.5 + confidence / 2])
        return float(low), float(high)

    def probability(self, snr: Floats) -> Floats:
        """The probability of detection at an SNR, shape as given."""
        return np.asarray(ndtr((snr - self.snr_50) / self.width))


def fit_detection(snr: Floats, is_detected: Floats, draws: int = 300) -> DetectionCurve:
    """Fit the curve by maximum likelihood; its errors from trials drawn again."""
    best = _fit_normal(snr, is_detected)
    rng = np.random.default_rng(0)
    chance = ndtr((snr - best[0]) / best[1])
    again = [_fit_normal(snr, (rng.random(snr.size) < chance).astype(float)) for _ in range(draws)]
    return DetectionCurve(float(best[0]), float(best[1]), np.array(again))


def _fit_normal(snr: Floats, is_detected: Floats) -> Floats:
    sign = np.where(is_detected > 0.5, 1.0, -1.0)

    def cost(place: Floats) -> float:
        middle, log_width = place
        return float(-log_ndtr(sign * (snr - middle) / np.exp(log_width)).sum())

    found = minimize(cost, (5.5, 0.0), method="Nelder-Mead", bounds=((0.0, 30.0), (-2.0, 3.0)))
    return np.array([found.x[0], np.exp(found.x[1])])
