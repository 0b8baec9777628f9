"""What every antenna model answers: the Jones terms of one dipole, by direction from its arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_channels
from lbacal_core.provenance import hash_arrays

Complexes = NDArray[np.complex128]


class AntennaModel(Protocol):
    """One dipole of an antenna; both dipoles of an LBA are the same model turned by the azimuth of their arms.

    The angle that places a direction is `azimuth_from_arm`: azimuth of the direction minus azimuth of the arm,
    both north through east. The azimuth of its arm defines a dipole; ``X`` or ``Y`` alone does not.
    """

    @property
    def name(self) -> str:
        """Name of the antenna model in the provenance of results."""
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


# An antenna model from a table of Jones terms on a grid of frequency, zenith angle and azimuth.

_WRAP = 4
"""Azimuth columns repeated on either side, so that the spline is periodic to rounding where it is used."""


@dataclass(frozen=True)
class JonesTable:
    """J_theta and J_phi of one dipole, interpolated by cubic splines in each angle and in frequency.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    zenith_deg
        Shape (zenith,), from 0 to at least 85; beyond the last row the last row holds, up to the horizon.
    azimuth_deg
        Shape (azimuth,), from the arm, north through east, evenly spaced, 0 included and 360 not.
    theta, phi
        Shape (freq, zenith, azimuth), complex, V per V/m or any constant times that.
    has_level
        Whether the terms of different frequencies have one constant in common, so that G_ant follows from them.
    """

    name: str
    frequency_mhz: Floats
    zenith_deg: Floats
    azimuth_deg: Floats
    theta: Complexes
    phi: Complexes
    has_level: bool = True

    def __post_init__(self) -> None:
        place = f"antenna {self.name}"
        require_channels(place, self.frequency_mhz)
        zenith, azimuth = self.zenith_deg, self.azimuth_deg
        if zenith.size < 4 or zenith[0] != 0 or not 85 <= zenith[-1] <= 180 or np.any(np.diff(zenith) <= 0):
            raise BadInputError(f"{place}: zenith_deg", "at least 4 angles rising from 0 to 85 or more", f"{zenith}")
        if azimuth.size < 8 or not np.allclose(azimuth, np.arange(azimuth.size) * 360.0 / azimuth.size):
            raise BadInputError(f"{place}: azimuth_deg", "8 or more even steps from 0 to below 360", f"{azimuth}")
        shape = (self.frequency_mhz.size, zenith.size, azimuth.size)
        for field in ("theta", "phi"):
            values = getattr(self, field)
            if values.shape != shape:
                raise BadInputError(f"{place}: {field}", f"shape {shape} (freq, zenith, azimuth)", f"{values.shape}")
            if not np.all(np.isfinite(values)):
                raise BadInputError(
                    f"{place}: {field}, row {np.argwhere(~np.isfinite(values))[0]}", "finite numbers", "another"
                )
        if not np.all(np.abs(self.theta[:, 0]).max(axis=-1) + np.abs(self.phi[:, 0]).max(axis=-1) > 0):
            raise BadInputError(place, "a response at zenith at every frequency", "none")

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """J_theta and J_phi, shape (freq, ...)."""
        low, high = self.frequency_mhz[0], self.frequency_mhz[-1]
        outside = (frequency_mhz < low) | (frequency_mhz > high)
        if np.any(outside):
            raise BadInputError(
                f"antenna {self.name}: frequency_mhz", f"{low:g} to {high:g} MHz", f"{frequency_mhz[outside][0]:g} MHz"
            )
        visible = np.asarray(zenith) < np.pi / 2
        rows = np.minimum(np.degrees(zenith), self.zenith_deg[-1])
        columns = np.degrees(azimuth_from_arm) % 360.0
        rows, columns = np.broadcast_arrays(rows, columns)
        theta, phi = (self._interpolate(values, frequency_mhz, rows, columns) for values in (self.theta, self.phi))
        return theta * visible, phi * visible

    def _interpolate(self, values: Complexes, frequency_mhz: Floats, rows: Floats, columns: Floats) -> Complexes:
        from scipy.interpolate import CubicSpline, RectBivariateSpline  # half a second that few who import this need

        if not np.array_equal(frequency_mhz, self.frequency_mhz):
            values = (
                values[[0]] if self.frequency_mhz.size == 1 else CubicSpline(self.frequency_mhz, values)(frequency_mhz)
            )
        wrapped = np.concatenate([values[..., -_WRAP:], values, values[..., : _WRAP + 1]], axis=-1)
        step = 360.0 / self.azimuth_deg.size
        azimuth = np.arange(-_WRAP, self.azimuth_deg.size + _WRAP + 1) * step
        result = np.empty((frequency_mhz.size, *rows.shape), dtype=complex)
        for row, surface in enumerate(wrapped):
            real = RectBivariateSpline(self.zenith_deg, azimuth, surface.real).ev(rows, columns)
            imaginary = RectBivariateSpline(self.zenith_deg, azimuth, surface.imag).ev(rows, columns)
            result[row] = real + 1j * imaginary
        return result

    def digest(self) -> str:
        """Hash of the table."""
        return hash_arrays(self.frequency_mhz, self.zenith_deg, self.azimuth_deg, self.theta, self.phi)
