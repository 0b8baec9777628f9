from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from lbacal_core.discovery.trials import p_of, sigma_of, trials_factor


def test_independent_scores_count_each_and_equal_ones_count_once():
    assert 38 < trials_factor(np.eye(50), seed=1) < 64  # the 90 % quantile of 2000 draws: 7 % of 10 %
    assert trials_factor(np.ones((50, 50)), seed=1) < 1.3


def test_steps_at_many_dates_are_more_trials_at_a_high_score_than_at_a_low_one():
    """The factor of a low score was taken for all: steps at 5 sigma had half the probability that they have."""
    share = np.arange(1, 200) / 200
    after, before = np.maximum.outer(share, share), np.minimum.outer(share, share)
    steps = np.sqrt(before * (1 - after) / (after * (1 - before)))
    rng = np.random.default_rng(2)
    chance = np.zeros(2)
    root = np.linalg.cholesky(steps + 1e-9 * np.eye(len(steps)))
    for _ in range(20):
        largest = np.abs(rng.standard_normal((4000, len(steps))) @ root.T).max(axis=1)
        chance += [np.mean(largest > 3.2) / 20, np.mean(largest > 4.2) / 20]
    trials = [trials_factor(steps, seed=1, level=level) for level in (3.2, 4.2)]
    assert p_of(3.2, trials[0]) == pytest.approx(chance[0], rel=0.15)
    assert p_of(4.2, trials[1]) == pytest.approx(chance[1], rel=0.25)  # 170 draws beyond: 8 %
    assert trials[1] > 1.3 * trials_factor(steps, seed=1)


def test_the_last_digits_of_correlations_do_not_move_the_trials_factor():
    """Equal eigenvalues have no eigenvectors of their own: draws along them moved it by up to 17 %."""
    correlation = np.kron(np.eye(12), 0.7 * np.ones((4, 4)) + 0.3 * np.eye(4))
    noise = 1e-12 * np.random.default_rng(3).standard_normal(correlation.shape)
    moved = trials_factor(correlation + noise + noise.T, seed=1)
    np.testing.assert_allclose(moved, trials_factor(correlation, seed=1), rtol=1e-6)


def test_probability_and_sigma_are_each_others_inverse():
    np.testing.assert_allclose(p_of(5.0, 1.0), 2 * norm.sf(5.0), rtol=1e-6)
    np.testing.assert_allclose(sigma_of(p_of(4.2, 1.0)), 4.2, rtol=1e-5)  # 1e-5 is what erfcinv keeps of p
