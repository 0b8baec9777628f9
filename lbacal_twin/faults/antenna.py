"""Faults of the active antenna: its resonance, its amplifier's noise and gain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats
from lbacal_twin.faults.drivers import driver, since
from lbacal_twin.faults.fault import Fault
from lbacal_twin.settings import YEAR_S
from lbacal_twin.stages import Scene, Stages

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
        """The antenna with the fault."""
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


@dataclass(frozen=True, kw_only=True)
class ResonanceShift(ResonanceFault):
    """The resonance moves by `size` MHz."""

    def change(self, strength: Floats) -> tuple[Floats, Floats]:
        """A shift alone."""
        return self.size * strength, np.zeros_like(strength)


@dataclass(frozen=True, kw_only=True)
class ResonanceWidth(ResonanceFault):
    """The resonance widens by the fraction `size`."""

    def change(self, strength: Floats) -> tuple[Floats, Floats]:
        """A widening alone."""
        return np.zeros_like(strength), self.size * strength


@dataclass(frozen=True, kw_only=True)
class LnaNoiseSlope(Fault):
    """N_LNA rises along frequency by `size` (fraction) per 25 MHz about 55 MHz."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Sloping amplifier noise."""
        factor = 1.0 + self.where.mask(scene) * self.size * (scene.frequency_mhz - 55.0) / 25.0
        return replace(stages, lna_noise=stages.lna_noise * factor)


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class GainDrift(Fault):
    """The gain in front of N_RCU changes by `size` (fraction) a year, through 1 in the middle of the campaign."""

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Ageing gain."""
        middle = 0.5 * (scene.time_unix.min() + scene.time_unix.max())
        years = (scene.time_unix[:, None] - middle) / YEAR_S
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * self.size * years))
