from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.levels import HEAVY, _scatter, is_heavy


def test_normal_amounts_keep_their_covariance_and_hardly_any_is_heavy():
    rng = np.random.default_rng(8)
    truth = np.array([[2.0, 0.6, 0.0], [0.6, 1.0, 0.1], [0.0, 0.1, 0.1]])
    amount = rng.multivariate_normal(np.zeros(3), truth, 20_000)
    assert is_heavy(amount).mean() == pytest.approx(HEAVY, abs=5 * (HEAVY / 20_000) ** 0.5)
    np.testing.assert_allclose(_scatter(amount), truth, atol=0.05)
