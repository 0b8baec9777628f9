"""Antennas with an exact answer: they test every integral, and are the plainest thing to compare with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.constants import speed_of_light

from lbacal_core.antenna.model import Complexes
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content


@dataclass(frozen=True)
class IsotropicAntenna:
    """The same response to every direction above the horizon."""

    name: str = "isotropic"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """Unit response to the theta component."""
        visible = (np.asarray(zenith) < np.pi / 2) & np.isfinite(azimuth_from_arm)
        theta = np.broadcast_to(visible, (frequency_mhz.size, *visible.shape)).astype(complex)
        return theta, np.zeros_like(theta)

    def digest(self) -> str:
        """Hash of the definition."""
        return hash_content([self.name])


@dataclass(frozen=True)
class QuarterWaveDipole:
    """A short level dipole a quarter of a wavelength above a perfectly conducting plane, at every frequency.

    A stand-in for a log-periodic antenna, whose active part keeps its height in wavelengths: the pattern of
    `ShortDipole` with k h = pi/2, the same at all frequencies.
    """

    name: str = "quarter-wave"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """Per unit length of the dipole."""
        cosine = np.cos(zenith)
        image = np.ones(frequency_mhz.size).reshape((-1,) + (1,) * np.ndim(zenith)) * (
            2j * np.sin(np.pi / 2 * cosine) * (cosine > 0)
        )
        return image * cosine * np.cos(azimuth_from_arm), -image * np.sin(azimuth_from_arm)

    def digest(self) -> str:
        """Hash of the definition."""
        return hash_content([self.name])


@dataclass(frozen=True)
class ShortDipole:
    """A short dipole at a height above a perfectly conducting plane, level unless it is tilted.

    J_theta = cos(theta) cos(phi) s, J_phi = -sin(phi) s with s = 2i sin(k h cos(theta)): the dipole and its image,
    a quarter of a textbook (Balanis, Antenna Theory, 3rd ed., eq. 4-116). The image of what stands upright has the
    same sign: J_theta = -sin(theta) 2 cos(k h cos(theta)) (eq. 4-94).
    """

    height_m: float
    name: str = "short-dipole"
    tilt_deg: float = 0.0

    def tilted(self, tilt_deg: float) -> ShortDipole:
        """The dipole with the end that points to the azimuth of its arm raised."""
        return replace(self, tilt_deg=self.tilt_deg + tilt_deg, name=f"{self.name}(tilt_deg={tilt_deg:g})")

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """Per unit length of the dipole."""
        wavenumber = (2 * np.pi * 1e6 * frequency_mhz / speed_of_light).reshape((-1,) + (1,) * np.ndim(zenith))
        cosine = np.cos(zenith)
        phase, tilt = wavenumber * self.height_m * cosine, np.radians(self.tilt_deg)
        image = 2j * np.sin(phase) * (cosine > 0) * np.cos(tilt)
        upright = -2.0 * np.cos(phase) * (cosine > 0) * np.sin(tilt) * np.sin(zenith)
        return image * cosine * np.cos(azimuth_from_arm) + upright, -image * np.sin(azimuth_from_arm)

    def solid_angle(self, frequency_mhz: Floats) -> Floats:
        """Integral of D over the hemisphere in closed form, sr, shape (freq,).

        pi / sin^2(a) times the integral over u = cos(theta) in 0 ... 1 of (1 + u^2) sin^2(a u), a = k h, which is
        2/3 - sin(2a)/(2a) - cos(2a)/(4a^2) + sin(2a)/(8a^3) (our integration by parts).
        """
        a = 2 * np.pi * 1e6 * frequency_mhz / speed_of_light * self.height_m
        integral = 2 / 3 - np.sin(2 * a) / (2 * a) - np.cos(2 * a) / (4 * a**2) + np.sin(2 * a) / (8 * a**3)
        return np.asarray(np.pi * integral / np.sin(a) ** 2)

    def digest(self) -> str:
        """Hash of the definition."""
        return hash_content([self.name, self.height_m, *([self.tilt_deg] if self.tilt_deg else [])])
