"""What an antenna hands to the amplifier behind it, from impedances or S11, and the amplifier's noise at that antenna.

A field E makes the voltage h E at the open feed of an antenna of the effective length h, of which |h E|^2 / (4 R_A) is
available (Balanis 2016, Antenna Theory, eq. 2-94): a G_ant of |h|^2 R_r / (4 R_A) in front of the mismatch. From an
antenna of impedance Z_A = R_A + i X_A a load Z_L takes the share 4 R_A R_L / |Z_A + Z_L|^2 of the available
power, which is 1 - |S11|^2 where Z_L is the reference impedance of S11. An amplifier with the noise parameters T_min,
R_n and Z_opt adds T_min + T_0 R_n / G_A |1/Z_A - 1/Z_opt|^2 to the temperature of the antenna, G_A = Re(1/Z_A) and
T_0 = 290 K (Haus et al. 1960, Proc. IRE 48, 69, with T = T_0 (F - 1)).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.data.constants import BOLTZMANN, IMPEDANCE_OF_FREE_SPACE, SPEED_OF_LIGHT
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, interpolate
from lbacal_core.instrument.touchstone import read_touchstone

Impedance = NDArray[np.complex128]
"""Ohm, shape (freq,)."""
RESISTANCE_OHM = 50.0
"""R_r of eq. total_sky_power_eq: one constant, which cancels in C; the same as the default of spectra files."""
T_0 = 290.0
"""Temperature at which noise figures are defined, K."""


def power_per_kelvin_sr(frequency_mhz: Floats) -> Floats:
    """k_B Z_0 nu^2 / (c^2 R_r) of eq. total_sky_power_eq, shape (freq,), W m^-2 MHz^-1 K^-1 sr^-1.

    k_B and not 2 k_B: the half of the unpolarised response is inside, so that G_ant D = |J_theta|^2 + |J_phi|^2.
    """
    hertz_per_mhz = 1e6
    nu = frequency_mhz * hertz_per_mhz
    return np.asarray(
        BOLTZMANN * IMPEDANCE_OF_FREE_SPACE * nu**2 / (SPEED_OF_LIGHT**2 * RESISTANCE_OHM) * hertz_per_mhz
    )


def length_gain(length_m: Floats, antenna: Impedance) -> Floats:
    """G_ant of an antenna by its effective length for a field along its arm, as available power, m^2, shape (freq,)."""
    if not np.all(length_m > 0):
        raise BadInputError("antenna: length", "an effective length above 0, in m", f"{np.min(length_m):g}")
    return np.asarray(length_m**2 * RESISTANCE_OHM / (4.0 * antenna.real))


def turn_reflection(impedance: Impedance, off: complex, place: str) -> Impedance:
    """The impedance with its reflection to 50 ohm off by a complex fraction of it: 0.05 in size, 0.05j in phase."""
    s11 = (1.0 + off) * (impedance - RESISTANCE_OHM) / (impedance + RESISTANCE_OHM)
    return require_passive(RESISTANCE_OHM * (1.0 + s11) / (1.0 - s11), place)


def match_power(antenna: Impedance, load: Impedance) -> Floats:
    """The share of the antenna's available power that the load takes, shape (freq,)."""
    return np.asarray(4.0 * antenna.real * load.real / np.abs(antenna + load) ** 2)


def match_noise(antenna: Impedance, t_min_k: float, r_n_ohm: float, optimum: Impedance) -> Floats:
    """Noise temperature of an amplifier beside the antenna's own, in front of the mismatch, K, shape (freq,)."""
    for name, value in (("least noise temperature, K", t_min_k), ("R_n, ohm", r_n_ohm)):
        if not value >= 0:
            raise BadInputError(f"amplifier: {name}", "0 or more", f"{value:g}")
    distance = np.abs(1.0 / antenna - 1.0 / optimum) ** 2
    return np.asarray(t_min_k + T_0 * r_n_ohm * distance / (1.0 / antenna).real)


def require_passive(impedance: Impedance, place: str) -> Impedance:
    """Refuse a resistance that is not above 0."""
    wrong = impedance.real[~(impedance.real > 0)]
    if wrong.size:
        raise BadInputError(place, "an impedance in ohm whose real part is above 0", f"{wrong[0]:g}")
    return impedance


def interpolate_impedance(nu: Floats, impedance: Impedance, frequency_mhz: Floats, place: str) -> Impedance:
    """Impedances of a table, shape (row,), ohm, on the channels, shape (freq,), which it must cover.

    S11 to 50 ohm is linear between its rows.
    """
    s11 = (impedance - RESISTANCE_OHM) / (impedance + RESISTANCE_OHM)
    found = 1j * interpolate(nu, s11.imag, frequency_mhz, place)
    found += interpolate(nu, s11.real, frequency_mhz, place)
    return require_passive(RESISTANCE_OHM * (1.0 + found) / (1.0 - found), place)


def read_impedance(path: Path, frequency_mhz: Floats) -> Impedance:
    """Read the impedance of a Touchstone file of one port or two, from S11, on the channels, shape (freq,), ohm."""
    nu, s, reference = read_touchstone(path)
    s11 = s[:, 0, 0]
    if np.any(np.abs(s11) >= 1.0):
        raise BadInputError(f"{path}: S11", "a reflection below 1", f"{np.abs(s11).max():g}")
    return interpolate_impedance(nu, reference * (1.0 + s11) / (1.0 - s11), frequency_mhz, str(path))
