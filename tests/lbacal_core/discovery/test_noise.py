from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.noise import split_residuals
from tests.lbacal_core.discovery.vectors import NU, THREE

FLAT = np.ones((1, 51))


def test_the_levels_of_known_noise_are_found(station, noise):
    levels = split_residuals(station, noise, FLAT).levels
    assert abs(levels.path_channel / 0.044 - 1) < 0.02  # 1/sqrt(2 x 16 paths x 300 events x 50) is 0.15 %
    # a vector of 51 channels: its amount is root 51 times the gain
    assert abs((levels.mean_path_shared[0, 0, 0] / 51) ** 0.5 / 0.04 - 1) < 0.05  # the median of 16 paths
    assert abs((levels.common_sum[0, 0, 0] / 51) ** 0.5 / (0.03 * 2**0.5) - 1) < 0.15  # 300 events: 4 %, and the paths
    assert (levels.common_difference[0, 0, 0] / 51) ** 0.5 < 0.008
    np.testing.assert_allclose(levels.path_scale, 1.0)


def test_a_dead_antenna_leaves_the_mean_but_is_still_compared_with_it(station, noise):
    relative_variance = station.relative_variance.copy()
    dead = station.antenna == station.antenna[0]
    relative_variance[dead, 100:] = np.inf
    damaged = replace(station, relative_variance=relative_variance)
    residuals = split_residuals(damaged, noise * damaged.is_present[:, :, None], FLAT)
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
    in_mean = split_residuals(damaged, noise * damaged.is_present[:, :, None], FLAT).in_mean
    assert not np.any(in_mean[late])
    assert np.all(in_mean[~late])


def test_a_noisy_path_gets_its_own_scale(station, noise):
    louder = noise.copy()
    louder[3] *= 2.0
    residuals = split_residuals(station, louder, FLAT)
    scale = residuals.levels.path_scale
    assert abs(scale[3] - 2.0) < 0.2  # its own share of the mean is taken out of it
    # the mean of eight paths, one of them with four times the variance
    own = residuals.polarisations == station.dipole[3]
    assert np.mean(residuals.spread[own]) == pytest.approx((7 + 4) / 8**2, rel=0.1)
    assert np.mean(residuals.spread[~own]) == pytest.approx(1 / 8, rel=0.1)
    np.testing.assert_allclose(np.delete(scale, 3), 1.0, atol=0.06)


def test_gains_with_a_shape_along_frequency_are_found_for_the_means_and_for_paths(station, noise):
    """Only a gain flat in frequency was noise; any other was structure, or a name."""
    flat = noise - noise.mean(axis=2, keepdims=True)
    of_path, of_mean = [], []
    for seed in range(8):  # one draw knows the variance of the means to a third
        rng = np.random.default_rng(seed)
        front = 0.04 * rng.standard_normal((*noise.shape[:2], 1)) * THREE[1]
        moved = 0.02 * rng.standard_normal((1, noise.shape[1], 1)) * THREE[2]
        levels = split_residuals(station, flat + front + moved, THREE).levels
        of_path.append(np.diag(levels.vectors.T @ levels.of_all(levels.mean_path_shared) @ levels.vectors))
        of_mean.append(np.diag(levels.vectors.T @ levels.of_all(levels.common_sum) @ levels.vectors / 2))
    assert np.sqrt(np.mean(of_path, axis=0)) == pytest.approx(0.04 * THREE[1], rel=0.1)
    found = np.sqrt(np.mean(of_mean, axis=0))[18:21]
    assert found == pytest.approx(0.02 * np.abs(THREE[2, 18:21]), rel=0.3)


def test_what_follows_an_axis_is_structure_and_no_noise_that_events_share(station, noise):
    """A wave along LST that most events have was taken for a vector of their noise, and nothing was left to find."""
    wave = np.cos(2 * np.pi * station.conditions.lst_hours / 24)[None, :, None] * THREE[2]
    still = split_residuals(station, noise, THREE).levels
    levels = split_residuals(station, noise + 0.02 * wave, THREE).levels
    assert np.trace(levels.common_sum[0]) < 2 * np.trace(still.common_sum[0]) + 1e-6


def test_what_most_events_share_is_noise_and_what_a_few_have_is_not(station, noise):
    rng = np.random.default_rng(6)
    shape, events = np.sin(9 * NU), noise.shape[1]
    often = noise + 0.02 * rng.standard_normal((1, events, 1)) * shape
    burst = noise + 0.12 * (np.arange(events) % 36 == 0)[:, None] * shape
    seeds = np.concatenate([FLAT, NU[None]])
    in_often, in_burst = (split_residuals(station, one, seeds).levels.vectors for one in (often, burst))
    along = [np.linalg.norm(vectors @ shape) / np.linalg.norm(shape) for vectors in (in_often, in_burst)]
    by_seeds = np.linalg.norm(np.linalg.qr(seeds.T)[0].T @ shape) / np.linalg.norm(shape)
    assert along[0] > 0.9
    assert along[1] == pytest.approx(by_seeds, abs=0.05)


def test_levels_are_at_most_three_vectors(station, noise):
    seeds = np.concatenate([THREE, NU[None]])
    levels = split_residuals(station, noise, seeds).levels
    assert levels.vectors.shape == (3, 51)
    assert np.linalg.matrix_rank(levels.common_sum[0]) <= 3


def test_bursts_in_a_few_events_do_not_count_as_noise(station, noise):
    """Lightning in six events of a hundred made its own level, and the search said "consistent"."""
    is_hit = (np.arange(noise.shape[1]) % 16 == 0)[None, :, None]
    still, burst = (split_residuals(station, one, THREE).levels for one in (noise, noise + 0.2 * is_hit * THREE[1]))
    assert np.trace(burst.common_sum[0]) == pytest.approx(np.trace(still.common_sum[0]), rel=0.15)


def test_gains_that_all_paths_share_leave_nothing_in_the_deviations_of_those_that_show_more(station, noise):
    """Paths on one cable name moved together, and a step of one that nobody had hidden was named at 5.4 sigma."""
    rng = np.random.default_rng(11)
    classes = len(station.conditions.dipoles)
    share = np.array([1.0 - 0.2 * (name == "115") for name in station.conditions.cables])[:, None]
    seeds = np.stack([np.ones((classes, 51)), share * THREE[1], share * THREE[2]], axis=1)
    gain, shift = 0.03 * rng.standard_normal((1, 300, 1)), 0.03 * rng.standard_normal((1, 300, 1))
    own = 0.04 * rng.standard_normal((*noise.shape[:2], 1)) * seeds[station.class_of, 1][:, None]
    common = gain * seeds[station.class_of, 1][:, None] + shift * seeds[station.class_of, 2][:, None]
    still, residuals = (
        split_residuals(station, 0.5 * (noise - noise.mean(axis=2, keepdims=True)) + own + one, seeds)
        for one in (0.0, common)
    )
    long = np.array(station.conditions.cables)[station.class_of] == "115"
    taken = residuals.taken[long].mean(axis=0)
    truth = (residuals.deviation + residuals.taken - still.deviation - still.taken)[long].mean(axis=0)
    # the mean of a polarisation has gains of eight paths, 1.4 % beside 3 %, and what follows an axis stays
    assert np.std(truth - taken) < 0.6 * np.std(truth)
    # those on the long cable show less of their own gains, too
    one, other = (
        levels.vectors.T @ levels.path_shared[0, c] @ levels.vectors
        for levels in [residuals.levels]
        for c in (int(station.class_of[long][0]), int(station.class_of[~long][0]))
    )
    assert np.trace(one) / np.trace(other) == pytest.approx(0.64, rel=0.15)
