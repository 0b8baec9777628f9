from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.model import directional_response
from lbacal_core.antenna.unfolding import IMPEDANCE_OF_FREE_SPACE, effective_area, effective_heights


def test_a_matched_short_dipole_in_free_space_has_three_eighths_of_lambda_squared_over_pi() -> None:
    wavelength, length = 5.0, 0.1
    # Radiation resistance of a short dipole; the matched load sees half of the open-circuit height.
    resistance = 2 * np.pi / 3 * IMPEDANCE_OF_FREE_SPACE * (length / wavelength) ** 2
    area = effective_area(np.array((length / 2) ** 2), resistance)
    assert area == pytest.approx(3 / (8 * np.pi) * wavelength**2, rel=1e-12)


def test_the_square_of_the_height_is_gain_times_response() -> None:
    nu, gain = np.array([40.0, 60.0]), np.array([0.2, 3.0])
    height = effective_heights(load_hamaker(), gain, nu, 0.8, 2.5)
    response = directional_response(load_hamaker(), nu, np.array([0.8]), np.array([2.5]))[:, 0]
    assert np.sum(np.abs(height) ** 2, axis=1) == pytest.approx(gain * response, rel=1e-12)
