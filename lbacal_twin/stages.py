"""The twin's own signal chain, written from eq. full_chain without the code of `chain`, so that each tests the other.

Every stage is an array that broadcasts against (antenna, dipole, event, freq); a fault replaces the stages it acts on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.view import View
from lbacal_twin.weather import Weather


@dataclass(frozen=True)
class Scene:
    """What surrounds one station during a campaign.

    Attributes
    ----------
    antennas, cables
        Shape (antenna,), numbers, and names of the cables at the first event.
    time_unix, lst_hours, temperature_c, rain_mm_h
        Shape (event,).
    sky_power
        P_sky of each dipole at any LST.
    weather
        The weather at any instant, for what follows it with a delay.
    view
        Our own sky and antenna by direction, for what has a direction.
    """

    station: str
    latitude_deg: float
    longitude_deg: float
    frequency_mhz: Floats
    antennas: NDArray[np.int64]
    cables: NDArray[np.str_]
    time_unix: Floats
    lst_hours: Floats
    temperature_c: Floats
    rain_mm_h: Floats
    sky_power: SkyPower
    weather: Weather
    view: View

    @property
    def dipoles(self) -> tuple[str, ...]:
        """Letters of the dipoles, in the order of the axis."""
        return tuple(sorted(self.sky_power.power))

    def sky_at(self, lst_hours: Floats) -> Floats:
        """P_sky at one LST per event, shape (1, dipole, event, freq)."""
        return np.stack([self.sky_power.at(dipole, lst_hours) for dipole in self.dipoles])[None]

    @property
    def mean_sky(self) -> Floats:
        """P_sky averaged over LST, shape (1, dipole, 1, freq)."""
        return np.stack([self.sky_power.power[dipole].mean(axis=0) for dipole in self.dipoles])[None, :, None]

    @property
    def warmth(self) -> Floats:
        """Air temperature above 10 degrees Celsius in units of 10 K, shape (event, 1)."""
        return (self.temperature_c[:, None] - 10.0) / 10.0

    @property
    def utc_hours(self) -> Floats:
        """UTC hour of day, shape (event, 1)."""
        return (self.time_unix[:, None] / 3600.0) % 24.0


@dataclass(frozen=True)
class Stages:
    """The signal chain of one station, stage by stage in the order of eq. full_chain.

    Attributes
    ----------
    sky
        P_sky, directional, its unit that of the sky power.
    lna_noise
        N_LNA, referred to the sky.
    antenna
        G_ant A, the antenna and its correction.
    gain
        Gain of the path, in front of N_RCU.
    cable
        L_coax.
    rcu_noise
        N_RCU, at the input of the receiver.
    receiver
        G_RCU S.
    adc_noise
        N_ADC, at the output, ADC^2/Ohm/MHz.
    """

    sky: Floats
    lna_noise: Floats
    antenna: Floats
    gain: Floats
    cable: Floats
    rcu_noise: Floats
    receiver: Floats
    adc_noise: Floats

    def power_at_converter(self) -> Floats:
        """What reaches the converter, before its own noise; ADC^2/Ohm/MHz."""
        slope = self.gain * self.antenna * self.cable * self.receiver
        power = self.sky * slope
        power += self.lna_noise * slope + self.rcu_noise * self.receiver
        return power
