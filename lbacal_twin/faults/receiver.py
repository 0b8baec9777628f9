"""Faults of the receiver and the converter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_twin.faults.drivers import driver, since
from lbacal_twin.faults.fault import Fault
from lbacal_twin.stages import Scene, Stages


@dataclass(frozen=True, kw_only=True)
class FilterShift(Fault):
    """The receiver's pass band moves along frequency by the fraction `size`, with what it follows or from a date."""

    follows: str = "temperature"
    date: str = ""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """G_RCU at nu (1 + shift)."""
        strength = since(self.date, scene) if self.date else driver(self.follows, scene)
        frequency = scene.frequency_mhz
        spline = CubicSpline(frequency, np.log(stages.receiver[0, 0, 0]))
        ratio = np.exp(spline(frequency * (1.0 + self.size * strength)) - spline(frequency))
        return replace(stages, receiver=stages.receiver * (1.0 + self.where.mask(scene) * (ratio - 1.0)))


@dataclass(frozen=True, kw_only=True)
class MissingNoise(Fault):
    """A noise that the model lacks: white, `size` in the unit of the place where it enters."""

    stage: str = "lna"

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """More noise at one stage."""
        names = {"lna": "lna_noise", "rcu": "rcu_noise", "adc": "adc_noise"}
        if self.stage not in names:
            raise UnknownNameError("stage", self.stage, list(names))
        level = getattr(stages, names[self.stage]) + self.where.mask(scene) * self.size
        return replace(stages, **{names[self.stage]: level})


@dataclass(frozen=True, kw_only=True)
class AdcNoiseStep(Fault):
    """N_ADC changes by `size` (fraction) on a date."""

    date: str

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Converter noise before and after."""
        factor = 1.0 + self.where.mask(scene) * self.size * since(self.date, scene)
        return replace(stages, adc_noise=stages.adc_noise * factor)


@dataclass(frozen=True, kw_only=True)
class Compression(Fault):
    """The gain of a path falls by `size` x (its total power / its own mean total power - 1)."""

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """The receiver saturates a little when the Galaxy is up."""
        total = power.sum(axis=3, keepdims=True)
        excess = total / total.mean(axis=2, keepdims=True) - 1.0
        return np.asarray(power * (1.0 - self.where.mask(scene) * self.size * excess))


@dataclass(frozen=True, kw_only=True)
class AdcJitter(Fault):
    """Sampling jitter: white noise in proportion to the integral of nu^2 P.

    On average over the events of a path it is `size` times the path's mean power per channel.
    """

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """Noise that rises with the slope of the signal."""
        steepness = power @ scene.frequency_mhz**2
        relative = (steepness / steepness.mean(axis=2, keepdims=True))[..., None]
        mean = power.mean(axis=(2, 3), keepdims=True)
        return np.asarray(power + self.where.mask(scene) * self.size * mean * relative)
