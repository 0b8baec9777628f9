"""Campaigns of CS002 whose recorded power follows sidereal time: the two judges of a fit and of an investigation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

STATION = "CS002"


def simulate(simulation: Simulation, seed: int, antennas: int = 8, events: int = 600) -> Spectra:
    """Clean spectra under the simulation's own sky."""
    settings = TwinSettings(stations=(STATION,), antennas=antennas, events_per_year=events)
    rng = np.random.default_rng(seed)
    return simulate_campaign(settings, simulation.instrument, simulation.sky_power, rng).spectra


def with_gain(
    spectra: Spectra, simulation: Simulation, size: float, harmonic: int = 1, *, slopes: bool = False
) -> Spectra:
    """The recorded power times 1 + a cos(h LST), or times a slope from -1 to 1 along frequency beside that."""
    angle = 2.0 * np.pi / 24.0 * simulation.sidereal_time(STATION, spectra.time_unix)
    form = np.linspace(-1.0, 1.0, spectra.frequency_mhz.size) if slopes else np.ones(spectra.frequency_mhz.size)
    return replace(spectra, power=spectra.power * (1.0 + size * np.cos(harmonic * angle)[:, None] * form))
