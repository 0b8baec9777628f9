"""Antennas with an exact answer: they test every integral, and are the plainest thing to compare with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.antenna.model import Complexes
from lbacal_core.data.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content


@dataclass(frozen=True)
class IsotropicAntenna:
    """The same response to every direction above the horizon."""

    name: str = "isotropic"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """Unit response to the theta component, and none to phi, shape (freq, ...) each."""
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
        """J_theta and J_phi per unit length of the dipole, shape (freq, ...) each; angles in rad."""
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
        """J_theta and J_phi per unit length of the dipole, shape (freq, ...) each; angles in rad."""
        wavenumber = (2 * np.pi * 1e6 * frequency_mhz / SPEED_OF_LIGHT).reshape((-1,) + (1,) * np.ndim(zenith))
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
        a = 2 * np.pi * 1e6 * frequency_mhz / SPEED_OF_LIGHT * self.height_m
        integral = 2 / 3 - np.sin(2 * a) / (2 * a) - np.cos(2 * a) / (4 * a**2) + np.sin(2 * a) / (8 * a**3)
        return np.asarray(np.pi * integral / np.sin(a) ** 2)

    def digest(self) -> str:
        """Hash of the definition."""
        return hash_content([self.name, self.height_m, *([self.tilt_deg] if self.tilt_deg else [])])


# An inverted-V dipole over ground, from its currents: it shares nothing with fitted or simulated beams.

SEGMENTS = 8
"""Gauss-Legendre nodes along an arm of less than half a wavelength: the response is exact to 1e-8."""


@dataclass(frozen=True)
class InvertedV:
    """Two straight arms that slope down from a feed, each with a sinusoidal current that ends at its tip, over ground.

    The response to a plane wave is the integral of the current along the arms times the incident field and the field
    that the ground reflects, with Fresnel's coefficients of an even soil (Balanis, Antenna Theory, 3rd ed., eq. 4-125
    and section 4.8). Coupling of the soil into the current is left out.

    Attributes
    ----------
    arm_m
        Length of each arm.
    feed_m
        Height of the feed above ground.
    droop_deg
        Angle of the arms below the horizontal.
    permittivity, conductivity
        Relative permittivity of the soil, and its conductivity in S/m; infinite for a perfect conductor.
    """

    arm_m: float = 1.38
    feed_m: float = 1.5
    droop_deg: float = 45.0
    permittivity: float = 13.0
    conductivity: float = 5e-3
    name: str = "inverted-v"

    def __post_init__(self) -> None:
        lowest = self.feed_m - self.arm_m * np.sin(np.radians(self.droop_deg))
        if not (self.arm_m > 0 and lowest > 0):
            raise BadInputError(f"antenna {self.name}", "arms above the ground", f"a tip at {lowest:.2f} m")
        if not (self.permittivity >= 1 and self.conductivity >= 0):
            raise BadInputError(
                f"antenna {self.name}",
                "permittivity >= 1, conductivity >= 0",
                f"{self.permittivity}, {self.conductivity}",
            )

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """Effective length along theta and phi for a current of 1 at the feed, m, shape (freq, ...) each."""
        # neither is spread over the grid of both: the costly exponentials know no azimuth
        zenith, azimuth = np.asarray(zenith, dtype=float), np.asarray(azimuth_from_arm, dtype=float)
        cosine, sine = np.cos(zenith), np.sin(zenith)
        wavenumber = (2e6 * np.pi / SPEED_OF_LIGHT * frequency_mhz).reshape((-1,) + (1,) * zenith.ndim)
        across, along = sine * np.cos(azimuth), np.cos(azimuth)
        direct, reflected = self._moments(wavenumber, across, cosine)
        vertical, horizontal = self._fresnel(frequency_mhz, zenith)
        theta = along * cosine * direct[0] - sine * direct[1]
        theta = theta - vertical * (along * cosine * reflected[0] + sine * reflected[1])
        phi = -np.sin(azimuth) * (direct[0] + horizontal * reflected[0])
        visible = zenith < np.pi / 2
        return theta * visible, phi * visible

    def _moments(self, wavenumber: Floats, across: Floats, up: Floats) -> Complexes:
        """Integrals of the current along both arms with the phase of a wave, m.

        Shape (wave, moment, freq, ...): the direct and the reflected wave, the horizontal moment along the arms and the
        vertical one.
        """
        nodes, weights = np.polynomial.legendre.leggauss(SEGMENTS)
        droop = np.radians(self.droop_deg)
        moments = np.zeros((2, 2, *np.broadcast_shapes(wavenumber.shape, across.shape)), dtype=complex)
        for position, weight in zip((nodes + 1) / 2 * self.arm_m, weights / 2 * self.arm_m, strict=True):
            current = weight * np.sin(wavenumber * (self.arm_m - position)) / np.sin(wavenumber * self.arm_m)
            height = self.feed_m - position * np.sin(droop)
            reach = wavenumber * position * np.cos(droop) * across
            # The current flows up one arm and down the other: horizontal parts add, vertical parts oppose each other.
            horizontal, vertical = 2 * np.cos(droop) * np.cos(reach), -2j * np.sin(droop) * np.sin(reach)
            carrier = current * np.exp(1j * wavenumber * height * up)
            for of_wave, phase in zip(moments, (carrier, carrier.conj()), strict=True):
                of_wave[0] += horizontal * phase
                of_wave[1] += vertical * phase
        return moments

    def _fresnel(self, frequency_mhz: Floats, zenith: Floats) -> tuple[Complexes, Complexes]:
        """Reflection coefficients for the field in the plane of incidence and across it, shape (freq, ...)."""
        if np.isinf(self.conductivity):
            return np.ones((1,) * (1 + zenith.ndim), dtype=complex), -np.ones((1,) * (1 + zenith.ndim), dtype=complex)
        loss = self.conductivity / (2e6 * np.pi * frequency_mhz * VACUUM_PERMITTIVITY)
        soil = (self.permittivity - 1j * loss).reshape((-1,) + (1,) * zenith.ndim)
        cosine, inside = np.cos(zenith), np.sqrt(soil - np.sin(zenith) ** 2)
        return (soil * cosine - inside) / (soil * cosine + inside), (cosine - inside) / (cosine + inside)

    def digest(self) -> str:
        """Hash of the definition."""
        return hash_content([self.name, *(str(value) for value in self.__dict__.values())])
