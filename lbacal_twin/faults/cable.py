"""Faults of the coaxial cable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lbacal_twin.faults.fault import Fault
from lbacal_twin.stages import Scene, Stages


@dataclass(frozen=True, kw_only=True)
class CableLength(Fault):
    """The cable is `size` metres longer than its record.

    Loss per metre of the LOFAR cable (Coax 9): 0.0816 dB at 30 MHz, rising as the root of frequency (skin effect).
    """

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """More cable, more loss."""
        decibel = self.size * 0.0816 * np.sqrt(scene.frequency_mhz / 30.0)
        return replace(stages, cable=stages.cable * 10.0 ** (-0.1 * self.where.mask(scene) * decibel))


@dataclass(frozen=True, kw_only=True)
class CableReflection(Fault):
    """Two mismatched ends: a standing wave of relative power amplitude `size` along frequency.

    The ripple of a monochromatic wave, averaged over the channel, which damps it by sinc(delay x width).
    """

    delay_us: float = 0.65
    phase_rad: float = 0.0

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """A rippled cable."""
        frequency = scene.frequency_mhz[:, None]
        width = np.gradient(scene.frequency_mhz)[:, None]
        fine = (np.arange(64) + 0.5) / 64 * width - width / 2
        wave = np.cos(2 * np.pi * self.delay_us * (frequency + fine) + self.phase_rad).mean(axis=1)
        return replace(stages, cable=stages.cable * (1.0 + self.where.mask(scene) * self.size * wave))


@dataclass(frozen=True, kw_only=True)
class CableTemperature(Fault):
    """The cable's loss in dB follows the air temperature, `size` (fraction) per 10 K."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """The loss of a warm day."""
        exponent = self.where.mask(scene) * self.size * scene.warmth
        return replace(stages, cable=stages.cable * np.exp(exponent * np.log(stages.cable)))
