"""A small station simulated by the twin, which shares no code with what is tested here."""

from collections.abc import Callable

import numpy as np
import pytest

from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.station import Station, gather_stations
from lbacal_core.grids import Floats
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.settings import TwinSettings

SETTINGS = TwinSettings(stations=("CS002",), antennas=8, events_per_year=300)
SEED = 20140101


@pytest.fixture(scope="session")
def clean(chain, sky) -> Spectra:
    """A year of eight antennas of CS002, nothing hidden."""
    return simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED)).spectra


@pytest.fixture(scope="session")
def spoil(chain, sky) -> Callable[[Fault], Spectra]:
    """The same year with one fault, planted by the twin."""
    return lambda fault: simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), [fault]).spectra


@pytest.fixture(scope="session")
def station(clean, simulation) -> Station:
    return gather_stations(clean, simulation)[0]


@pytest.fixture(scope="session")
def baseline(station):
    return fit_baseline(station)


@pytest.fixture(scope="session")
def model(station) -> LinearModel:
    """The chain fitted to the clean station."""
    return fit_chain(station).linear


@pytest.fixture(scope="module")
def look(world):
    """A small station with nothing hidden, fitted."""
    return world.look()


@pytest.fixture(scope="session")
def noise(station: Station) -> Floats:
    """Residuals of known noise: 4.4 % a channel, 4 % a path and 3 % common, flat in frequency."""
    rng = np.random.default_rng(3)
    paths, events, channels = station.power.shape
    own = 0.044 * rng.standard_normal((paths, events, channels)) + 0.04 * rng.standard_normal((paths, events, 1))
    return own + 0.03 * rng.standard_normal((1, events, 1))
