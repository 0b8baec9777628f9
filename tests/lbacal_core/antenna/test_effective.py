from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.effective import (
    IMPEDANCE_OF_FREE_SPACE,
    effective_area,
    split_gain_and_response,
    unpolarised_height_squared,
)
from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.model import power_pattern


def test_a_matched_short_dipole_in_free_space_has_three_eighths_of_lambda_squared_over_pi() -> None:
    wavelength, length = 5.0, 0.1
    # Radiation resistance of a short dipole; the matched load sees half of the open-circuit height.
    resistance = 2 * np.pi / 3 * IMPEDANCE_OF_FREE_SPACE * (length / wavelength) ** 2
    area = effective_area(np.array((length / 2) ** 2), resistance)
    assert area == pytest.approx(3 / (8 * np.pi) * wavelength**2, rel=1e-12)


def test_gain_and_response_multiply_to_the_power_pattern() -> None:
    nu, zenith, azimuth = np.array([40.0, 60.0]), np.array([0.1, 0.8]), np.array([0.5, 2.5])
    gain, response = split_gain_and_response(load_hamaker(), nu, zenith, azimuth)
    power = power_pattern(load_hamaker(), nu, zenith, azimuth)
    assert 2 * unpolarised_height_squared(gain, response) == pytest.approx(power, rel=1e-12)
