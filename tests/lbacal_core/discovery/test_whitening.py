from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.whitening import split_residuals


@pytest.fixture(scope="module")
def residuals(station, baseline):
    return split_residuals(station, baseline.residual)


def test_pulling_back_is_the_transpose_of_whitening(residuals):
    rng = np.random.default_rng(1)
    values = rng.standard_normal(residuals.mean.shape)
    whitened = residuals.whiten_mean(values)
    other = rng.standard_normal(whitened.shape)
    np.testing.assert_allclose(whitened @ other, np.sum(values * residuals.pull_back_mean(other)), rtol=1e-10)
    values = rng.standard_normal(residuals.mean.shape[1:])
    whitened = residuals.whiten_path(values)
    other = rng.standard_normal(whitened.shape)
    np.testing.assert_allclose(whitened @ other, np.sum(values * residuals.pull_back_path(other)), rtol=1e-10)


def test_inner_products_need_no_whitening(residuals):
    rng = np.random.default_rng(2)
    values = rng.standard_normal((3, *residuals.mean.shape))
    whitened = residuals.whiten_mean(values)
    np.testing.assert_allclose(residuals.gram_mean(values, values), whitened @ whitened.T, rtol=1e-9)
    values = rng.standard_normal((3, *residuals.mean.shape[1:]))
    whitened = residuals.whiten_path(values)
    np.testing.assert_allclose(residuals.norm_path(values), np.sum(whitened**2, axis=1), rtol=1e-9)


def test_levels_are_those_of_the_twin(residuals):
    levels = residuals.levels
    # 300 events: 4 % on an event gain; radiometer 1/sqrt(512) in each channel
    np.testing.assert_allclose(levels.path_channel, 512**-0.5, rtol=0.02)
    np.testing.assert_allclose(levels.path_band, np.hypot(0.04, 512**-0.5 / np.sqrt(51)), rtol=0.1)
    # common 3 % for both letters: the half sum times sqrt 2 has sqrt(2) x 3 %, plus 4 % / sqrt(8)
    np.testing.assert_allclose(levels.mean_sum, np.hypot(np.sqrt(2) * 0.03, 0.04 / np.sqrt(8)), rtol=0.15)


def test_whitened_residuals_have_unit_variance(residuals):
    whitened = residuals.whiten_mean(residuals.mean)
    # each channel's line takes 2 of 300 events; a channel's deviation from the band mean has 50/51 of the variance
    np.testing.assert_allclose(np.mean(whitened**2), 298 / 300 * 50 / 51, rtol=0.005)
