"""The factor in front of the sky integral."""

from __future__ import annotations

import numpy as np

from lbacal_core.data.constants import BOLTZMANN, IMPEDANCE_OF_FREE_SPACE, SPEED_OF_LIGHT
from lbacal_core.grids import Floats
from lbacal_core.instrument.matching import RESISTANCE_OHM


def power_per_kelvin_sr(frequency_mhz: Floats) -> Floats:
    """k_B Z_0 nu^2 / (c^2 R_r) of eq. total_sky_power_eq, shape (freq,), W m^-2 MHz^-1 K^-1 sr^-1.

    k_B and not 2 k_B: the half of the unpolarised response is inside, so that G_ant D = |J_theta|^2 + |J_phi|^2.
    """
    hertz_per_mhz = 1e6
    nu = frequency_mhz * hertz_per_mhz
    return np.asarray(
        BOLTZMANN * IMPEDANCE_OF_FREE_SPACE * nu**2 / (SPEED_OF_LIGHT**2 * RESISTANCE_OHM) * hertz_per_mhz
    )
