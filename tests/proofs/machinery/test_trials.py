from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from proofs.machinery.trials import Rate, fit_detection, run_trials


def _square(number: int) -> int:
    return number * number


def test_outcomes_come_in_the_order_of_their_tasks():
    assert run_trials(_square, range(7), "squares") == [0, 1, 4, 9, 16, 25, 36]


def test_the_interval_of_a_rate_is_wilsons():
    low, high = Rate(0, 2000).interval
    # Wilson, no hits: z^2 / (n + z^2).
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(1.96**2 / (2000 + 1.96**2), rel=1e-3)
    assert Rate(12, 2000).is_at_most(0.005)
    assert not Rate(40, 2000).is_at_most(0.01)
    assert Rate(18, 20).is_at_least(0.95)


def test_the_curve_of_detection_finds_what_drew_the_trials():
    rng = np.random.default_rng(1)
    snr = np.repeat([4.0, 5.0, 5.5, 6.0, 7.5, 10.0], 300)
    detected = (rng.random(snr.size) < norm.cdf((snr - 5.4) / 1.1)).astype(float)
    curve = fit_detection(snr, detected, draws=60)
    for share in (0.5, 0.95):
        middle, low, high = curve.snr_at(share)
        assert low < middle < high
        # 1800 trials know the curve to some 0.05; four times that.
        assert middle == pytest.approx(5.4 + 1.1 * norm.ppf(share), abs=0.2)
