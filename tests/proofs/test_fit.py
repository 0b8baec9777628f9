"""A small instance of `./dev prove fit`, on the package's own sky."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from proofs.fit import Outcome, Scene, fit_data_sets, judge, load_scenes, scene_of_noise_terms

DATA_SETS = 40


@pytest.fixture(scope="module")
def scene() -> Scene:
    instrument = load_instrument("lofar-superterp")
    return scene_of_noise_terms(instrument, compute_sky_power(instrument))


@pytest.fixture(scope="module")
def outcome(scene: Scene) -> Outcome:
    return fit_data_sets(scene, DATA_SETS, seed=1)


def test_errors_are_those_of_the_fisher_bound(outcome: Outcome):
    # a standard deviation from 40 draws is known to 11 %: 3.5 of these
    ratio = np.sqrt(np.mean((outcome.error / outcome.bound) ** 2, axis=0))
    assert np.all((ratio > 0.6) & (ratio < 1.4))


def test_pulls_have_mean_0_and_standard_deviation_1(outcome: Outcome):
    # 3.5 standard deviations of the mean and of the standard deviation of 40 draws
    assert np.all(np.abs(outcome.pull.mean(axis=0)) < 3.5 / np.sqrt(DATA_SETS))
    assert np.all(np.abs(outcome.pull.std(axis=0) - 1) < 3.5 / np.sqrt(2 * DATA_SETS))


def test_chi2_per_dof_is_1(outcome: Outcome):
    # 48 degrees of freedom: one chi2_per_dof scatters by 0.2, the mean of 40 by 0.03
    assert outcome.chi2_per_dof.mean() == pytest.approx(1.0, abs=0.12)


@pytest.mark.shared
@pytest.mark.usefixtures("shared")
def test_the_bound_on_the_example_sky_is_that_of_an_independent_estimate():
    # both from the design page, to its two digits: 0.40 % at the example's noise, 0.62 % at that of noise_terms.csv
    for scene, expected in zip(load_scenes(None, None, None), (0.0040, 0.0062), strict=True):
        _, sky = scene.draw(np.random.default_rng(3))
        assert np.median(scene.smallest_errors(sky)[:-3]) == pytest.approx(expected, rel=0.04)


def test_the_constants_give_the_published_shares(scene: Scene):
    n_lna, n_rcu, n_adc = scene.noise
    at_55 = scene.instrument.frequency_mhz == 55
    sky = scene.sky_power.power["X"].mean(axis=0)[at_55]
    # noise_terms.csv at 55 MHz: sky 1.322e-14, LNA 5.976e-15; one N_LNA for all channels: to the spread of the sky
    assert n_lna / sky == pytest.approx(5.976e-15 / 1.322e-14, rel=0.1)
    assert n_adc == 1.0
    # the RCU's share of the ADC's is near 1.2 below 57 MHz, where G_RCU is flat
    assert n_rcu * scene.instrument.receiver_gain[at_55] == pytest.approx(1.2, rel=0.15)


@pytest.mark.parametrize("fault", ["too_wide", "off", "wrong_sigma"])
def test_a_fit_that_is_off_does_not_hold(fault: str):
    rng = np.random.default_rng(2)
    draws = np.repeat(rng.standard_normal((1000, 1)), 54, axis=1)
    scale = {"too_wide": (1.2, 1.0), "off": (1.0, 1.0), "wrong_sigma": (1.0, 1.2)}[fault]
    shift = 0.2 if fault == "off" else 0.0
    bad = Outcome(0.004 * scale[0] * draws, scale[1] * draws + shift, np.full((1000, 54), 0.004), np.ones(1000))
    good = Outcome(0.004 * draws, draws, np.full((1000, 54), 0.004), np.ones(1000))
    assert judge(good)[0]
    assert not judge(bad)[0]


def test_the_sky_is_interpolated_as_the_package_does(scene: Scene):
    lst = np.array([0.0, 3.3, 23.9])
    table: SkyPower = scene.sky_power
    np.testing.assert_allclose(scene.sky_at(lst), table.at("X", lst), rtol=1e-10)
