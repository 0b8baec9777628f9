"""Faults between the sky and the dipole: directions, polarisations, clocks, and other sources and absorbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.constants import Boltzmann, speed_of_light

from lbacal_core.grids import Floats
from lbacal_core.sky.model import find_sources
from lbacal_twin.bodies import horizontal, sun_position
from lbacal_twin.faults.fault import Fault, between_hours
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.view import View

REFERENCE_MHZ = 55.0


class SkyFault(Fault):
    """A fault of the sky power that a path receives."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """The sky with the fault on the paths it touches."""
        mask = self.where.mask(scene)
        changed = self.seen(stages.sky, scene)
        return replace(stages, sky=stages.sky + mask * (changed - stages.sky))

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Sky power of a path with the fault, instead of `sky`, shape (antenna, dipole, event, freq)."""
        raise NotImplementedError


class DipoleSwap(SkyFault):
    """Each dipole receives `size` of the other's power; 1: their cables are exchanged."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Part of the other dipole's sky in place of the own."""
        del scene
        return (1.0 - self.size) * sky + self.size * sky[:, ::-1]


class DipoleAzimuth(SkyFault):
    """Both arms stand `size` degrees east of their record."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Compute the sky through turned dipoles."""
        return sky * scene.view.ratio(lambda _, pattern: pattern, scene.lst_hours, turned_deg=self.size)


class LstOffset(SkyFault):
    """The sky is that of `size` hours after the recorded time."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """The sky of another sidereal time, in proportion to whatever else acts on it."""
        return sky * scene.sky_at(scene.lst_hours + self.size) / scene.sky_at(scene.lst_hours)


class ZenithWeighting(SkyFault):
    """Directions count with a further cos(zenith angle) to the power `size`."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """The sky through a pattern of another width and total power."""

        def weigh(zenith: Floats, pattern: Floats) -> Floats:
            return np.asarray(pattern * np.clip(np.cos(zenith), 1e-9, 1.0) ** self.size)

        return sky * scene.view.ratio(weigh, scene.lst_hours)


class PatternWidth(SkyFault):
    """The gain at zenith is `size` (fraction) higher at the same total power: the pattern is a power of itself."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """The sky through a narrower pattern with more gain at zenith."""

        def narrow(zenith: Floats, pattern: Floats) -> Floats:
            del zenith
            first = pattern[:, :1]
            total = first.sum(axis=(0, 2), keepdims=True)
            logarithm = np.log(np.maximum(first, 1e-12))
            power = np.zeros_like(total)
            for _ in range(20):  # Newton: the power p at which the sum of D^p is the total over (1 + size)
                now = first * np.exp(power * logarithm)
                slope = (now * logarithm).sum(axis=(0, 2), keepdims=True)
                power = power - (now.sum(axis=(0, 2), keepdims=True) - total / (1.0 + self.size)) / slope
            return np.asarray((1.0 + self.size) * pattern * np.exp(power * np.log(np.maximum(pattern, 1e-12))))

        return sky * scene.view.ratio(narrow, scene.lst_hours)


class IsotropicLevel(SkyFault):
    """Further emission from everywhere: `size` of the mean sky power at each frequency."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Add a constant to the sky."""
        return np.asarray(sky + self.size * scene.mean_sky.mean(axis=1, keepdims=True))


@dataclass(frozen=True, kw_only=True)
class ExtraSource(SkyFault):
    """A named source shines with a further `size` of its flux."""

    source: str = "cas-a"

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """The sky and the source, in the proportion of source to Galaxy in our own sky."""
        one = find_sources([self.source])[0]
        position = np.radians(one.right_ascension_deg), np.radians(one.declination_deg)
        response = _towards(scene.view, position, scene)
        wavelength = speed_of_light / (scene.frequency_mhz * 1e6)
        kelvin_sr = one.flux_jy(scene.frequency_mhz, 2015.0) * 1e-26 * wavelength**2 / (2 * Boltzmann)
        mean_sky = scene.mean_sky.mean(axis=1, keepdims=True)
        return np.asarray(sky + self.size * mean_sky * response * kelvin_sr / scene.view.mean_kelvin_sr)


@dataclass(frozen=True, kw_only=True)
class SolarEmission(SkyFault):
    """The quiet Sun: overhead, `size` of the mean sky power at 55 MHz, rising with frequency to the power `index`."""

    index: float = 1.5

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Add the Sun to the sky."""
        level = np.interp(REFERENCE_MHZ, scene.frequency_mhz, scene.mean_sky.mean(axis=(0, 1, 2)))
        spectrum = level * (scene.frequency_mhz / REFERENCE_MHZ) ** self.index
        return np.asarray(sky + self.size * spectrum * _towards(scene.view, sun_position(scene.time_unix), scene))


@dataclass(frozen=True, kw_only=True)
class IonosphericAbsorption(SkyFault):
    """The daytime D layer absorbs: optical depth `size` at 30 MHz under an overhead Sun, as frequency^-2."""

    power: float = 0.75
    """Exponent of the cosine of the Sun's zenith angle."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Compute the sky through the layer."""
        zenith, _ = horizontal(*sun_position(scene.time_unix), scene.lst_hours, scene.latitude_deg)
        daylight = np.clip(np.cos(zenith), 0.0, 1.0)[:, None] ** self.power * (np.cos(zenith) > 0)[:, None]
        return sky * np.exp(-self.size * daylight * (30.0 / scene.frequency_mhz) ** 2)


def _towards(view: View, position: tuple[Floats | float, Floats | float], scene: Scene) -> Floats:
    """D towards a position of date at each event, 0 below the horizon; shape (1, dipole, event, freq)."""
    right_ascension, declination = (np.asarray(angle) for angle in position)
    zenith, azimuth = horizontal(right_ascension, declination, scene.lst_hours, scene.latitude_deg)
    return view.response(zenith, azimuth, scene.frequency_mhz)[None]


# Faults of the site: transmitters, and the noise of people.


@dataclass(frozen=True, kw_only=True)
class RfiLine(Fault):
    """A transmitter's line, `size` of the mean power of its channel, between two UTC hours."""

    line_mhz: float = 45.0
    width_mhz: float = 1.0
    hours: tuple[float, float] = (0.0, 24.0)

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """A channel or a few with a constant on top."""
        profile = np.exp(-0.5 * ((scene.frequency_mhz - self.line_mhz) / (self.width_mhz / 2.355)) ** 2)
        is_on = between_hours(*self.hours, scene)
        level = power.mean(axis=2, keepdims=True)
        return np.asarray(power + self.where.mask(scene) * self.size * level * profile * is_on)


@dataclass(frozen=True, kw_only=True)
class RfiBroadband(Fault):
    """Noise of machines between two UTC hours: `size` of the mean sky power at 55 MHz, a power law in frequency."""

    index: float = -2.0
    hours: tuple[float, float] = (6.0, 18.0)

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """More power into the antenna during working hours."""
        level = np.interp(55.0, scene.frequency_mhz, scene.mean_sky.mean(axis=(0, 1, 2)))
        spectrum = level * (scene.frequency_mhz / 55.0) ** self.index
        added = self.where.mask(scene) * self.size * spectrum * between_hours(*self.hours, scene)
        return replace(stages, sky=stages.sky + added)
