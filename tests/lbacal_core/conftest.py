import numpy as np
import pytest

from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View
from tests.lbacal_core.discovery.worlds import World


@pytest.fixture(scope="session")
def chain() -> Instrument:
    return load_instrument("lofar-superterp")


@pytest.fixture(scope="session")
def sky(chain: Instrument) -> SkyPower:
    return compute_sky_power(chain)


@pytest.fixture(scope="session")
def simulation(chain: Instrument, sky: SkyPower) -> Simulation:
    return Simulation(chain, sky)


@pytest.fixture(scope="session")
def world(chain: Instrument, sky: SkyPower) -> World:
    """A year of three antennas of CS002: 200 events, the noise of the real array."""
    settings = TwinSettings(stations=("CS002",), antennas=3, events_per_year=200)
    return World(chain, sky, settings, View(chain))


@pytest.fixture(scope="session")
def two_stations() -> Spectra:
    """24 spectra: three events, an hour apart, of two stations with two antennas each, both dipoles."""
    keys = [
        (event, station, antenna, dipole)
        for event in range(3)
        for station in ("CS002", "CS003")
        for antenna in (0, 7)
        for dipole in "XY"
    ]
    event, station, antenna, dipole = (np.array(column) for column in zip(*keys, strict=True))
    frequency_mhz = np.array([30.0, 31.0, 32.0, 33.0])
    return Spectra(
        frequency_mhz=frequency_mhz,
        power=np.random.default_rng(1).uniform(1, 2, (len(keys), frequency_mhz.size)),
        event_id=np.array([f"event {k}" for k in event]),
        time_unix=1_400_000_000.0 + 3600.0 * event,
        station=station,
        antenna=antenna,
        dipole=dipole,
        blocks=np.full(len(keys), 100),
        environment={"temperature_c": 10.0 + event, "rain_mm_h": np.where(event == 0, np.nan, 0.0)},
    )
