from __future__ import annotations

import numpy as np

from lbacal_core.chain.model import calibration_factor, chain_power

FREQUENCY = np.linspace(30, 80, 11)
CHAIN = {
    "antenna_gain": 0.2 + np.exp(-(((FREQUENCY - 58) / 8) ** 2)),
    "correction": 1 + 0.1 * np.sin(FREQUENCY),
    "cable_loss": 10 ** (-0.1 * np.sqrt(FREQUENCY)),
    "receiver_gain": 1.1 - 0.009 * (FREQUENCY - 30),
    "scale": 3e4,
    "n_lna": 0.2,
    "n_rcu": 1e-3,
    "n_adc": 5.0,
}


def test_power_is_a_line_in_sky_power_with_the_slope_and_intercept_of_the_docstring():
    sky = np.outer([1.0, 2.0, 5.0], np.ones(11))
    slope = CHAIN["antenna_gain"] * CHAIN["correction"] * CHAIN["cable_loss"] * CHAIN["receiver_gain"] * CHAIN["scale"]
    intercept = CHAIN["n_lna"] * slope + CHAIN["n_rcu"] * CHAIN["scale"] * CHAIN["receiver_gain"] + CHAIN["n_adc"]
    np.testing.assert_allclose(chain_power(sky, **CHAIN), slope * sky + intercept, rtol=1e-12)


def test_noise_enters_behind_what_precedes_it():
    sky = np.ones((1, 11))
    base = chain_power(sky, **CHAIN)
    louder_adc = chain_power(sky, **{**CHAIN, "n_adc": 6.0})
    np.testing.assert_allclose(louder_adc - base, 1.0, rtol=1e-9)
    louder_rcu = chain_power(sky, **{**CHAIN, "n_rcu": 2e-3})
    np.testing.assert_allclose((louder_rcu - base)[0], 1e-3 * CHAIN["receiver_gain"] * CHAIN["scale"], rtol=1e-9)


def test_longer_cable_raises_c_with_frequency():
    slope = CHAIN["antenna_gain"] * CHAIN["cable_loss"]
    longer = CHAIN["antenna_gain"] * CHAIN["cable_loss"] ** 1.5
    ratio = calibration_factor(longer, CHAIN["antenna_gain"]) / calibration_factor(slope, CHAIN["antenna_gain"])
    assert np.all(ratio > 1)
    assert np.all(np.diff(ratio) > 0)


def test_antenna_gain_is_not_part_of_c():
    gain = CHAIN["antenna_gain"]
    rest = CHAIN["cable_loss"] * CHAIN["receiver_gain"]
    np.testing.assert_allclose(calibration_factor(gain * rest, gain), calibration_factor(7 * gain * rest, 7 * gain))
