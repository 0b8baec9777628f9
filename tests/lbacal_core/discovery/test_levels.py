from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.kinds import HEAVY, is_heavy
from lbacal_core.discovery.levels import STANDS_OUT, _beyond, _scatter, beyond_noise


def test_normal_amounts_keep_their_covariance_and_hardly_any_is_heavy():
    rng = np.random.default_rng(8)
    truth = np.array([[2.0, 0.6, 0.0], [0.6, 1.0, 0.1], [0.0, 0.1, 0.1]])
    amount = rng.multivariate_normal(np.zeros(3), truth, 20_000)
    assert is_heavy(amount).mean() == pytest.approx(HEAVY, abs=5 * (HEAVY / 20_000) ** 0.5)
    np.testing.assert_allclose(_scatter(amount), truth, atol=0.05)


def test_noise_has_no_vector_of_its_own_and_a_vector_beyond_noise_stands_out():
    rng = np.random.default_rng(5)
    largest = [np.linalg.eigvalsh(x.T @ x)[-1] for x in rng.standard_normal((200, 300, 48))]
    units = np.array([beyond_noise(float(value), 300, 48) for value in largest])
    assert np.mean(units) == pytest.approx(-1.2, abs=0.4)  # the law's mean is -1.21 and its spread 1.27
    assert np.sum(units > STANDS_OUT) <= 2
    strong = rng.standard_normal((300, 48)) + 1.2 * rng.standard_normal((300, 1)) * np.eye(48)[0]
    assert beyond_noise(float(np.linalg.eigvalsh(strong.T @ strong)[-1]), 300, 48) > STANDS_OUT


def test_the_noise_of_an_event_has_at_most_three_vectors():
    found = _beyond(np.diag([4.0, 3.0, 2.0, 1.5]), 0.5)
    np.testing.assert_allclose(np.diag(found), [3.5, 2.5, 1.5, 0.0])
