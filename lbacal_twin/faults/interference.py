"""Faults of the site: transmitters, and the noise of people."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.faults.drivers import between_hours
from lbacal_twin.faults.fault import Fault
from lbacal_twin.stages import Scene, Stages


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
