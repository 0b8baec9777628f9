from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.table import SkyPower
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.faults.sky import IsotropicLevel
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View

QUIET = TwinSettings(stations=("CS002",), events_per_year=300, event_gain_common=0, event_gain_path=0, radiometer=0)


@dataclass(frozen=True)
class Planted:
    """Noiseless power of a station with and without faults, shape (antenna, dipole, event, freq), and its events."""

    power: Floats
    clean: Floats
    time_unix: Floats
    lst_hours: Floats
    temperature_c: Floats
    rain_mm_h: Floats

    @property
    def effect(self) -> Floats:
        """Relative change of power."""
        return self.power / self.clean - 1.0


Plant = Callable[..., Planted]


@pytest.fixture(scope="session")
def plant(low_band: Instrument, two_waves: SkyPower, view: View) -> Plant:
    """Simulate the same quiet station-year with some faults and without."""

    def run(*faults: Fault) -> Planted:
        with_faults, without = (
            simulate_campaign(QUIET, low_band, two_waves, np.random.default_rng(1), chosen, view=view).spectra
            for chosen in (faults, ())
        )
        shape = (6, 2, 300, 51)
        events = slice(0, 300)
        return Planted(
            with_faults.power.reshape(shape), without.power.reshape(shape), without.time_unix[events],
            local_sidereal_time(without.time_unix[events], low_band.longitude_deg),
            without.environment["temperature_c"][events], without.environment["rain_mm_h"][events],
        )  # fmt: skip

    return run


@pytest.fixture
def slope(plant) -> Floats:
    """Recorded power per sky power, shape (antenna, dipole, freq), and so C^-2 G_ant, from two flat skies."""
    added = plant(IsotropicLevel(size=1.0))
    return (added.power - added.clean)[:, :, 0]
