from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.noise import (
    HEAVY,
    STANDS_OUT,
    NoiseLevels,
    _beyond,
    _choose_vectors,
    _scatter,
    beyond_noise,
    is_heavy,
)


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


def test_lines_of_interference_make_no_vector_of_the_noise():
    """Lines left in a fifth of the events, two in one channel, were a vector, along which they lie on one side."""
    rng = np.random.default_rng(7)
    events, channels = 760, 51
    seed = np.ones((1, channels)) / channels**0.5
    noise = rng.standard_normal((2, events, channels)) + 20.0 * rng.standard_normal((events, 1)) * seed
    line = np.zeros((events, channels))
    line[rng.choice(events, 150, replace=False), rng.integers(channels, size=150)] = rng.exponential(2.5, 150)
    line[[100, 500], 5] = 14.0
    tilt = rng.standard_normal((events, 1)) * np.cos(9 * np.linspace(-1, 1, channels)) / 5.0**0.5
    everyone = [np.arange(events)]
    assert len(_choose_vectors(noise + line, seed, everyone, 1.0)) == 1
    assert len(_choose_vectors(noise + tilt, seed, everyone, 1.0)) == 2
    # Beside cut lines a vector that is not orthogonal to the others gave information below 0, and scores of 18 sigma.
    chosen = _choose_vectors(noise + tilt + np.abs(line), seed, everyone, 1.0)
    np.testing.assert_allclose(chosen @ chosen.T, np.eye(2), atol=1e-12)


@pytest.mark.parametrize("wet", [38, 64])
def test_what_follows_rain_is_as_rare_as_noise_known_from_a_few_wet_events_makes_it(wet):
    """Noise of wet events that counted as exact made structure along rain five to twenty times too probable."""
    rng = np.random.default_rng(11)
    vectors = np.eye(51)[:3]
    kind_of = (np.arange(700) < wet).astype(np.int64)
    nothing = np.zeros((2, 3, 3))
    levels = NoiseLevels(vectors, kind_of, 1.0, nothing[:, None], np.ones(1), np.ones(1), np.zeros(2), nothing, nothing)
    draws = 100_000
    gain = rng.chisquare(6, draws)
    for _ in range(2):  # means of three amounts of each polarisation, over their scatter in as many events
        gain += wet * 3 / (wet - 3) * rng.f(3, wet - 3, draws)
    for p in (1e-2, 1e-3, 2e-4):
        one_in = float(np.quantile(gain, 1.0 - p))
        assert levels.chance_of_gain(one_in, 12, kind_of[None] * 1.0, 6) == pytest.approx(p, rel=0.45)
    assert levels.chance_of_gain(one_in, 12, np.ones((1, 700)), 6) < 0.4 * p  # in all events noise is known
