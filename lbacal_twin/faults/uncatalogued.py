"""Effects that no catalogue of causes lists, each of another kind, to test the report of unknown structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.bodies import horizontal, jupiter_position, sun_position
from lbacal_twin.faults.fault import Fault
from lbacal_twin.faults.sky import SkyFault
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import DAY_S, YEAR_S


class MainsHum(Fault):
    """The supply voltage of the cabinet swings twice a day, and the gain with it by the fraction `size` (UTC)."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """A gain of two waves a day, with peaks at 8 and 20 h UTC."""
        wave = np.cos(2 * np.pi * (scene.utc_hours - 8.0) / 12.0)
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * self.size * wave))


class WorkingWeek(Fault):
    """A workshop beside the cabinet: N_RCU is `size` (fraction) higher from Monday to Friday."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """More receiver noise on working days; 1970-01-01 was a Thursday."""
        weekday = (scene.time_unix[:, None] // DAY_S + 3) % 7
        return replace(stages, rcu_noise=stages.rcu_noise * (1.0 + self.where.mask(scene) * self.size * (weekday < 5)))


class JovianBursts(SkyFault):
    """Jupiter's decametric emission: below 40 MHz, when Jupiter is up and Io stands right; `size` of the sky there."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Power from one wandering direction, in some revolutions of Io only."""
        zenith, azimuth = horizontal(*jupiter_position(scene.time_unix), scene.lst_hours, scene.latitude_deg)
        io_period_s = 1.769_138 * DAY_S
        phase = scene.time_unix % io_period_s / io_period_s
        is_bursting = (np.abs(phase - 0.25) < 0.15)[:, None]
        spectrum = 1.0 / (1.0 + np.exp((scene.frequency_mhz - 38.0) / 1.5))
        response = scene.view.response(zenith, azimuth, scene.frequency_mhz)[None]
        level = scene.mean_sky.mean(axis=1, keepdims=True)
        return np.asarray(sky + self.size * level * spectrum * is_bursting * response)


class AuroralAbsorption(SkyFault):
    """Absorption at night that returns with the Sun's rotation of 27.3 days; optical depth `size` at 30 MHz."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """The sky behind a disturbed ionosphere, in a few nights of each rotation."""
        zenith, _ = horizontal(*sun_position(scene.time_unix), scene.lst_hours, scene.latitude_deg)
        rotation = scene.time_unix / (27.275 * DAY_S) % 1.0
        activity = np.where(zenith > np.pi / 2, np.exp(-0.5 * ((rotation - 0.5) / 0.08) ** 2), 0.0)[:, None]
        return sky * np.exp(-self.size * activity * (30.0 / scene.frequency_mhz) ** 2)


class FieldGradient(SkyFault):
    """A wall beside the field shadows the setting Galaxy, more for the antennas with high numbers."""

    def seen(self, sky: Floats, scene: Scene) -> Floats:
        """Sky power tilted over sidereal time by `size` from the first to the last antenna."""
        place = np.linspace(-0.5, 0.5, len(scene.antennas))[:, None, None, None]
        tilt = np.sin(2 * np.pi * (scene.lst_hours[:, None] - 14.0) / 24.0)
        return sky * (1.0 + self.size * place * tilt)


class FrostAndHeat(Fault):
    """The gain is lower by `size` (fraction) at 20 K from the best temperature, on either side of it."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """A parabola in temperature about 10 degrees."""
        factor = 1.0 - self.where.mask(scene) * self.size * (scene.warmth / 2.0) ** 2
        return replace(stages, gain=stages.gain * factor)


class BandSaturation(Fault):
    """One stage saturates between 54 and 62 MHz alone, by `size` x the relative excess of the power there."""

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """Compression of a sub-band by itself."""
        window = np.exp(-0.5 * ((scene.frequency_mhz - 58.0) / 2.5) ** 4)
        inside = power @ window
        excess = (inside / inside.mean(axis=2, keepdims=True) - 1.0)[..., None]
        return np.asarray(power * (1.0 - self.where.mask(scene) * self.size * excess * window))


class Thunderstorms(Fault):
    """Storms of a few hours, in summer: lightning adds `size` of the mean sky power at 30 MHz, as frequency^-3."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Bursts of events with steep excess power; which six-hour spells have a storm is fixed by their number."""
        spell = (scene.time_unix // (6 * 3600.0)).astype(np.int64)
        chance = (spell * 2_654_435_761 % 4_294_967_296) / 4_294_967_296  # Knuth's multiplicative hash
        summer = 0.5 + 0.5 * np.cos(2 * np.pi * (scene.time_unix / YEAR_S % 1.0 - 0.55))
        storm = (chance < 0.12 * summer)[:, None]
        spectrum = scene.mean_sky.mean(axis=(1, 2), keepdims=True)[..., :1] * (scene.frequency_mhz / 30.0) ** -3
        return replace(stages, sky=stages.sky + self.where.mask(scene) * self.size * spectrum * storm)


def uncatalogued_faults() -> Mapping[str, type[Fault]]:
    """Every effect without a name in the catalogue, with the axes it lives on as the key."""
    return {
        "utc": MainsHum,
        "date": WorkingWeek,
        "frequency, lst, date": JovianBursts,
        "frequency, utc, date": AuroralAbsorption,
        "antenna, lst": FieldGradient,
        "temperature": FrostAndHeat,
        "frequency, lst": BandSaturation,
        "event, frequency": Thunderstorms,
    }
