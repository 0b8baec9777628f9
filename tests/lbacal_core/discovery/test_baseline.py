from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.baseline import fit_baseline
from lbacal_twin.campaign import expected_power
from tests.lbacal_core.discovery.worlds import SILENT


@pytest.fixture(scope="module")
def silent(world):
    return world.with_settings(**SILENT, noise_level=0.0)


@pytest.fixture(scope="module")
def exact(silent):
    return silent.look()


def test_spectra_without_noise_leave_nothing_and_give_the_planted_constants(silent, exact):
    assert np.abs(exact.residual).max() < 1e-6
    truth = silent.station.truth
    planted = (truth.n_lna, truth.n_rcu, truth.n_adc)
    for k, name in enumerate(("n_lna", "n_rcu", "n_adc")):
        assert exact.noise_constants()[:, k] == pytest.approx(planted[k], rel=1e-4), name


def test_the_fitted_slope_is_the_planted_calibration_to_the_power_minus_two(silent, exact):
    planted = exact.arrange(silent.station.truth.c) ** -2 * silent.instrument.antenna_gain
    assert exact.slopes() == pytest.approx(planted, rel=1e-4)


def test_the_chain_of_the_mean_path_is_that_of_its_paths(silent, exact):
    planted = exact.arrange(expected_power(silent.station.stages, silent.station.scene, []))
    # The median of three gains that scatter by 4 %.
    assert exact.modelled_power() == pytest.approx(planted, rel=0.15)
    assert np.mean(exact.modelled_power() / planted) == pytest.approx(1.0, abs=0.04)


def test_a_level_that_comes_out_below_zero_is_taken_for_half_of_its_error(world):
    """As where somebody has taken the noise of the converter out of the spectra already, and a little more."""
    look = world.look()
    n_adc = np.median(look.noise_constants()[:, 2])
    less = fit_baseline(replace(look.data, power=look.data.power - 1.2 * n_adc))
    assert np.median(less.solution.q[:, 1]) < 0
    channels = less.solution.x.shape[1]
    error = np.sqrt(np.median(less.solution.covariance[:, channels + 2, channels + 2]))
    assert less.terms.adc_noise == pytest.approx(0.5 * error)
