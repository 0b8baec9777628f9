from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.noise import split_residuals


@pytest.fixture(scope="module")
def noise(station):
    """Residuals of known noise: 4.4 % a channel, 4 % a path and 3 % common, flat in frequency."""
    rng = np.random.default_rng(3)
    paths, events, channels = station.power.shape
    own = 0.044 * rng.standard_normal((paths, events, channels)) + 0.04 * rng.standard_normal((paths, events, 1))
    return own + 0.03 * rng.standard_normal((1, events, 1))


def test_the_levels_of_known_noise_are_found(station, noise):
    levels = split_residuals(station, noise).levels
    assert abs(levels.path_channel / 0.044 - 1) < 0.02  # 1/sqrt(2 x 16 paths x 300 events x 50) is 0.15 %
    assert abs(levels.path_band / np.hypot(0.04, 0.044 / 51**0.5) - 1) < 0.05  # the median of 16 paths
    assert abs(levels.common_sum / (0.03 * 2**0.5) - 1) < 0.15  # 300 events: 4 %, and the share of the paths
    assert levels.common_difference < 0.008
    np.testing.assert_allclose(levels.path_scale, 1.0)


def test_a_dead_antenna_leaves_the_mean_but_is_still_compared_with_it(station, noise):
    relative_variance = station.relative_variance.copy()
    dead = station.antenna == station.antenna[0]
    relative_variance[dead, 100:] = np.inf
    damaged = replace(station, relative_variance=relative_variance)
    residuals = split_residuals(damaged, noise * damaged.is_present[:, :, None])
    assert not np.any(residuals.in_mean[dead])
    assert np.all(residuals.in_mean[~dead])
    assert np.all(residuals.deviation[dead][:, 100:] == 0.0)
    assert np.all(residuals.deviation[dead][:, :100] != 0.0)


def test_an_antenna_that_dies_in_the_last_days_leaves_the_mean_and_one_with_gaps_does_not(station, noise):
    rng = np.random.default_rng(5)
    relative_variance = station.relative_variance.copy()
    late, gappy = station.antenna == station.antenna[0], station.antenna == station.antenna[-1]
    relative_variance[late, 275:] = np.inf
    relative_variance[np.ix_(gappy, rng.choice(300, 45, replace=False))] = np.inf
    damaged = replace(station, relative_variance=relative_variance)
    in_mean = split_residuals(damaged, noise * damaged.is_present[:, :, None]).in_mean
    assert not np.any(in_mean[late])
    assert np.all(in_mean[~late])


def test_a_noisy_path_gets_its_own_scale(station, noise):
    louder = noise.copy()
    louder[3] *= 2.0
    scale = split_residuals(station, louder).levels.path_scale
    assert abs(scale[3] - 2.0) < 0.2  # its own share of the mean is taken out of it
    np.testing.assert_allclose(np.delete(scale, 3), 1.0, atol=0.06)
