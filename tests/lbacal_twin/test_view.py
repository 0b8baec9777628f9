from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.view import View

LST = np.linspace(0, 24, 50, endpoint=False)


@pytest.fixture(scope="module")
def view(low_band: Instrument) -> View:
    return View(low_band)


def test_the_plain_sum_turns_dipoles_as_the_sky_power_does(low_band: Instrument, view: View) -> None:
    turned = replace(
        low_band, dipole_azimuth_deg={name: arm + 5.0 for name, arm in low_band.dipole_azimuth_deg.items()}
    )
    expected, plain = compute_sky_power(turned), compute_sky_power(low_band)
    ratio = view.ratio(lambda _, pattern: pattern, LST, turned_deg=5.0)[0]
    for row, dipole in enumerate("XY"):
        # Pixels of 3.7 degrees and a spline over 5 MHz; the effect itself is 2 %.
        np.testing.assert_allclose(ratio[row], expected.at(dipole, LST) / plain.at(dipole, LST), atol=2e-4)


def test_doing_nothing_has_the_ratio_one(view: View) -> None:
    np.testing.assert_allclose(view.ratio(lambda _, pattern: pattern, LST), 1.0, atol=1e-12)


def test_a_response_is_one_overhead_and_none_below_the_horizon(view: View) -> None:
    response = view.response(np.array([0.0, 1.0, 2.0]), np.array([0.3, 0.3, 0.3]), np.array([40.0, 60.0]))
    np.testing.assert_allclose(response[:, 0], 1.0, atol=0.005)  # fitted patterns: 0.1 % around the azimuth
    assert np.all(response[:, 2] == 0)
    assert np.all((response[:, 1] > 0) & (response[:, 1] < 1))


def test_the_mean_sky_is_that_of_the_sky_power(low_band: Instrument, view: View) -> None:
    mean = np.mean([compute_sky_power(low_band).power[dipole].mean(axis=0) for dipole in "XY"], axis=0)
    # k_B Z_0 nu^2 / (c^2 R_r) per MHz, R_r = 50 Ohm: eq. total_sky_power_eq
    per_kelvin = 1.380649e-23 * 376.730313668 * (low_band.frequency_mhz * 1e6 / 299_792_458.0) ** 2 / 50 * 1e6
    np.testing.assert_allclose(view.mean_kelvin_sr * per_kelvin, mean, rtol=5e-3)  # pixels at the horizon
