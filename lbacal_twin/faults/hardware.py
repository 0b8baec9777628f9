"""Faults behind the dipole: resonance, amplifier, cable, receiver and converter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_twin.faults.fault import Fault, driver, since
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import YEAR_S

CAPACITANCE_F, RESISTANCE_OHM = 16e-12, 700.0
"""Input impedance of the amplifier at the feed, as published for the LBA (15-17 pF, 700 Ohm)."""
RADIATION_OHM, INDUCTANCE_H = 70.0, 3.3e-6
"""Resistance of the dipole: the loaded resonance is as narrow (5.3 MHz between its half-power points) as G_ant."""


def circuit_response(frequency_mhz: Floats, resonance_mhz: Floats, width: Floats) -> Floats:
    """Power that a series-resonant dipole delivers to a capacitive amplifier, up to a constant.

    A voltage source behind R_a (nu/nu_0)^2 + i X, X vanishing at the dipole's own resonance, into R parallel to C;
    the own resonance is placed so that the loaded one falls on `resonance_mhz`.

    Parameters
    ----------
    width
        Factor on the resistance of dipole and amplifier together, and with it on the width; 1 as built.
    """
    omega = 2e6 * np.pi * frequency_mhz
    load = 1.0 / (1.0 / RESISTANCE_OHM + 1j * omega * CAPACITANCE_F)
    at_peak = 2e6 * np.pi * resonance_mhz
    load_at_peak = 1.0 / (1.0 / RESISTANCE_OHM + 1j * at_peak * CAPACITANCE_F)
    # Above its own resonance a dipole is inductive: X = L (omega - own / omega); X and the load cancel at the peak.
    own = at_peak**2 + at_peak * load_at_peak.imag / INDUCTANCE_H
    resistance = RADIATION_OHM + (width - 1.0) * (RADIATION_OHM + load_at_peak.real)
    source = resistance * (frequency_mhz / resonance_mhz) ** 2
    reactance = INDUCTANCE_H * (omega - own / omega)
    return np.asarray(np.abs(load / (source + 1j * reactance + load)) ** 2)


@dataclass(frozen=True, kw_only=True)
class ResonanceFault(Fault):
    """The antenna's resonance moves or widens with what it follows."""

    follows: str = "wet"
    is_circuit: bool = True
    """Act through a circuit of dipole and amplifier; otherwise slide the antenna's own curve along frequency."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Change the antenna by the fault."""
        frequency = scene.frequency_mhz
        curve = np.broadcast_to(stages.antenna.mean(axis=(0, 2)), (len(scene.dipoles), frequency.size))
        peak = float(frequency[np.argmax(curve.mean(axis=0))])
        shift, widening = self.change(driver(self.follows, scene))
        if self.is_circuit:
            ratio = circuit_response(frequency, peak + shift, 1.0 + widening)
            ratio = (ratio / circuit_response(frequency, np.array(peak), np.array(1.0)))[None, None]
        else:
            at = peak + (frequency - peak - shift) / (1.0 + widening)
            spline = CubicSpline(frequency, np.log(curve), axis=1)
            ratio = np.exp(spline(at) - np.log(curve)[:, None])[None]
        return replace(stages, antenna=stages.antenna * (1.0 + self.where.mask(scene) * (ratio - 1.0)))

    def change(self, strength: Floats) -> tuple[Floats, Floats]:
        """Shift in MHz and relative widening at each event, shape (event, 1)."""
        raise NotImplementedError


class ResonanceShift(ResonanceFault):
    """The resonance moves by `size` MHz."""

    def change(self, strength: Floats) -> tuple[Floats, Floats]:
        """Shift the resonance alone."""
        return self.size * strength, np.zeros_like(strength)


class ResonanceWidth(ResonanceFault):
    """The resonance widens by the fraction `size`."""

    def change(self, strength: Floats) -> tuple[Floats, Floats]:
        """Widen the resonance alone."""
        return np.zeros_like(strength), self.size * strength


class LnaNoiseSlope(Fault):
    """N_LNA rises along frequency by `size` (fraction) per 25 MHz about 55 MHz."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Give the amplifier's noise a slope."""
        factor = 1.0 + self.where.mask(scene) * self.size * (scene.frequency_mhz - 55.0) / 25.0
        return replace(stages, lna_noise=stages.lna_noise * factor)


class LnaNoiseTemperature(Fault):
    """N_LNA follows the air temperature, `size` (fraction) per 10 K."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Amplifier noise of a warm day."""
        return replace(stages, lna_noise=stages.lna_noise * (1.0 + self.where.mask(scene) * self.size * scene.warmth))


@dataclass(frozen=True, kw_only=True)
class GainTemperature(Fault):
    """The gain in front of N_RCU follows the air temperature of some hours ago, `size` (fraction) per 10 K."""

    delay_h: float = 0.0

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Gain of a warm day."""
        earlier = scene.weather.temperature_at(scene.time_unix[:, None] - 3600.0 * self.delay_h)
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * self.size * (earlier - 10.0) / 10.0))


@dataclass(frozen=True, kw_only=True)
class GainStep(Fault):
    """The gain in front of N_RCU changes by `size` (fraction) on a date."""

    date: str

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Gain before and after."""
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * self.size * since(self.date, scene)))


class GainDrift(Fault):
    """The gain in front of N_RCU changes by `size` (fraction) a year, through 1 in the middle of the campaign."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Let the gain drift."""
        middle = 0.5 * (scene.time_unix.min() + scene.time_unix.max())
        years = (scene.time_unix[:, None] - middle) / YEAR_S
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * self.size * years))


# Faults of the coaxial cable.


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
        """Add a ripple to the loss of the cable."""
        frequency = scene.frequency_mhz[:, None]
        width = np.gradient(scene.frequency_mhz)[:, None]
        fine = (np.arange(64) + 0.5) / 64 * width - width / 2
        wave = np.cos(2 * np.pi * self.delay_us * (frequency + fine) + self.phase_rad).mean(axis=1)
        return replace(stages, cable=stages.cable * (1.0 + self.where.mask(scene) * self.size * wave))


class CableTemperature(Fault):
    """The cable's loss in dB follows the air temperature, `size` (fraction) per 10 K."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Raise the loss in dB on warm days."""
        exponent = self.where.mask(scene) * self.size * scene.warmth
        return replace(stages, cable=stages.cable * np.exp(exponent * np.log(stages.cable)))


# Faults of the receiver and the converter.


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


class Compression(Fault):
    """The gain of a path falls by `size` x (its total power / its own mean total power - 1)."""

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """The receiver saturates a little when the Galaxy is up."""
        total = power.sum(axis=3, keepdims=True)
        excess = total / total.mean(axis=2, keepdims=True) - 1.0
        return np.asarray(power * (1.0 - self.where.mask(scene) * self.size * excess))


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
