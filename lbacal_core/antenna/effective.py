"""Effective height and area (the paper's appendix on antenna theory), and G_ant and D from one table."""

from __future__ import annotations

import numpy as np
from scipy.constants import mu_0, speed_of_light

from lbacal_core.antenna.model import AntennaModel, directional_response, zenith_gain
from lbacal_core.grids import Floats

IMPEDANCE_OF_FREE_SPACE = mu_0 * speed_of_light


def unpolarised_height_squared(antenna_gain: Floats, response: Floats) -> Floats:
    """<|H|^2> = G_ant D / 2 for unpolarised waves, m^2 (section on Galactic emission).

    Parameters
    ----------
    antenna_gain
        G_ant, shape (freq,), m^2.
    response
        D, shape (freq, ...).
    """
    return np.asarray(0.5 * antenna_gain.reshape((-1,) + (1,) * (response.ndim - 1)) * response)


def effective_area(height_squared: Floats, resistance_ohm: float) -> Floats:
    """A_e = |H|^2 Z_0 / R_r (eq. AtoH), m^2, with H the height that gives the voltage at the load.

    An open-circuit height is twice that at a matched load, and then the same area reads |H|^2 Z_0 / (4 R_r).
    """
    return np.asarray(height_squared * IMPEDANCE_OF_FREE_SPACE / resistance_ohm)


def split_gain_and_response(
    antenna: AntennaModel, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats
) -> tuple[Floats, Floats]:
    """G_ant and D of one antenna model, whose product is |J_theta|^2 + |J_phi|^2, shapes (freq,) and (freq, ...)."""
    return zenith_gain(antenna, frequency_mhz), directional_response(antenna, frequency_mhz, zenith, azimuth_from_arm)
