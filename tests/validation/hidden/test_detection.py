from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from validation.hidden.detection import fit_detection


def test_the_curve_of_detection_finds_what_drew_the_trials():
    rng = np.random.default_rng(1)
    snr = np.repeat([4.0, 5.0, 5.5, 6.0, 7.5, 10.0], 300)
    detected = (rng.random(snr.size) < norm.cdf((snr - 5.4) / 1.1)).astype(float)
    curve = fit_detection(snr, detected, draws=60)
    for share in (0.5, 0.95):
        middle, (low, high) = curve.snr_at(share), curve.bounds(share, 0.95)
        assert low < middle < high
        # 1800 trials know the curve to some 0.05; four times that.
        assert middle == pytest.approx(5.4 + 1.1 * norm.ppf(share), abs=0.2)
