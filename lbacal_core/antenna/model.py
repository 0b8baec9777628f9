"""What every antenna model answers: the Jones terms of one dipole, by direction from its arm."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

Complexes = NDArray[np.complex128]


class AntennaModel(Protocol):
    """One dipole of an antenna; both dipoles of an LBA are the same model turned by the azimuth of their arms.

    The angle that places a direction is `azimuth_from_arm`: azimuth of the direction minus azimuth of the arm,
    both north through east. The azimuth of its arm defines a dipole; ``X`` or ``Y`` alone does not.
    """

    @property
    def name(self) -> str:
        """Name in provenance."""
        ...

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """J_theta and J_phi: voltage for a field along increasing zenith angle and azimuth, in m up to a constant.

        Parameters
        ----------
        frequency_mhz
            Shape (freq,), MHz.
        zenith, azimuth_from_arm
            Rad, of equally many axes, which broadcast to (...); below the horizon the response is zero.

        Returns
        -------
        Each of shape (freq, ...).
        """
        ...

    def digest(self) -> str:
        """Hash of the numbers, which names the model in provenance."""
        ...


def power_pattern(antenna: AntennaModel, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> Floats:
    """|J_theta|^2 + |J_phi|^2 = G_ant D, shape (freq, ...)."""
    theta, phi = antenna.jones(frequency_mhz, zenith, azimuth_from_arm)
    return np.asarray(np.abs(theta) ** 2 + np.abs(phi) ** 2)


def zenith_gain(antenna: AntennaModel, frequency_mhz: Floats) -> Floats:
    """G_ant up to the antenna model's constant: the power pattern at zenith, mean over azimuth, shape (freq,).

    The mean matters to fitted patterns only, whose theta and phi parts differ by some 0.1 % at zenith.
    """
    around = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    return np.asarray(power_pattern(antenna, frequency_mhz, np.zeros(8), around).mean(axis=-1))


def directional_response(
    antenna: AntennaModel,
    frequency_mhz: Floats,
    zenith: Floats,
    azimuth_from_arm: Floats,
    level: AntennaModel | None = None,
) -> Floats:
    """D(theta, phi) of eq. total_sky_power_eq, 1 at zenith and 0 below the horizon, shape (freq, ...).

    With `level`, the antenna with its arm level, D is 1 where that one is: G_ant is the level antenna's, and a raised
    arm may see nothing at zenith.
    """
    gain = zenith_gain(level or antenna, frequency_mhz).reshape((-1,) + (1,) * np.ndim(zenith))
    return np.asarray(power_pattern(antenna, frequency_mhz, zenith, azimuth_from_arm) / gain)
