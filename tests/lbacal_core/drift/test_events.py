from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.events import frequency_modes, measure_event_modes
from tests.lbacal_core.drift.test_monthly import MHZ, N_ADC, N_RCU, RECEIVER, SCALE, make_case


def test_a_tilt_in_front_of_the_receiver_is_measured_as_such() -> None:
    block, curve, instrument, sky = make_case(np.ones(40), np.random.default_rng(1), noise=0.0)
    modes = frequency_modes(MHZ)
    tilt = 1.0 + 0.02 * modes[0] - 0.01 * modes[1]
    behind = N_RCU * RECEIVER * SCALE + N_ADC
    block.power[:] = (block.power - behind) * tilt + behind
    found = measure_event_modes(block, {7: curve}, instrument, sky)
    # ln g = ln of the weighted mean, which is 1 + 0.02 <L1> - 0.01 <L2>; modes are relative to it, and half in C
    level = 1.0 + 0.02 * found.centre[0, 0] - 0.01 * found.centre[0, 1]
    # the weights, and with them the mean of a tilt, follow the sky: by a hundredth of the tilt over these 40 days
    assert found.ln_c[0, :, 0] == pytest.approx(-0.5 * np.log(level), abs=2e-4)
    assert found.ln_c[0, :, 1] == pytest.approx(-0.5 * 0.02 / level, abs=2e-5)
    assert found.ln_c[0, :, 2] == pytest.approx(0.5 * 0.01 / level, abs=2e-5)


def test_a_gain_of_all_channels_has_neither_tilt_nor_curvature() -> None:
    block, curve, instrument, sky = make_case(np.full(40, 1.3), np.random.default_rng(1), noise=0.0)
    found = measure_event_modes(block, {7: curve}, instrument, sky)
    assert found.ln_c[0, :, 0] == pytest.approx(-0.5 * np.log(1.3), rel=1e-9)
    assert np.abs(found.ln_c[0, :, 1:]).max() < 1e-9


def test_an_event_with_less_power_than_the_noise_of_the_receiver_has_no_value() -> None:
    block, curve, instrument, sky = make_case(np.ones(10), np.random.default_rng(1), noise=0.0)
    block.power[0, 3] = 0.5 * (N_RCU * RECEIVER * SCALE + N_ADC)
    found = measure_event_modes(block, {7: curve}, instrument, sky)
    assert np.isnan(found.ln_c[0, :, 0]).tolist() == [k == 3 for k in range(10)]
