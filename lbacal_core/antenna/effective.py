"""Effective height and area (the paper's appendix on antenna theory), on the scale of the G_ant of an instrument."""

from __future__ import annotations

import numpy as np
from scipy.constants import mu_0, speed_of_light

from lbacal_core.antenna.model import AntennaModel, Complexes, zenith_gain
from lbacal_core.grids import Floats

IMPEDANCE_OF_FREE_SPACE = mu_0 * speed_of_light


def effective_area(height_squared: Floats, resistance_ohm: float) -> Floats:
    """A_e = |H|^2 Z_0 / R_r (eq. AtoH), m^2, with H the height that gives the voltage at the load.

    An open-circuit height is twice that at a matched load, and then the same area reads |H|^2 Z_0 / (4 R_r).
    """
    return np.asarray(height_squared * IMPEDANCE_OF_FREE_SPACE / resistance_ohm)


def effective_heights(
    antenna: AntennaModel, antenna_gain: Floats, frequency_mhz: Floats, zenith: float, azimuth_from_arm: float
) -> Complexes:
    """Complex heights of one dipole for E_theta and E_phi from a direction, shape (freq, 2), m.

    The Jones terms of the antenna model give direction and phase, the G_ant of the instrument the size: |H|^2 =
    G_ant D, the height with which C was fitted. With another G_ant, C and H do not belong together.

    Parameters
    ----------
    antenna_gain
        G_ant of the instrument, shape (freq,), m^2.
    zenith, azimuth_from_arm
        Direction that the wave comes from, rad; azimuth minus that of the arm, both north through east.
    """
    theta, phi = antenna.jones(frequency_mhz, np.array([zenith]), np.array([azimuth_from_arm]))
    scale = np.sqrt(antenna_gain / zenith_gain(antenna, frequency_mhz))
    return np.asarray(scale[:, None] * np.stack([theta[:, 0], phi[:, 0]], axis=1))
