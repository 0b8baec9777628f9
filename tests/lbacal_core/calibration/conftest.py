"""A small sky, chain and campaign written out in plain NumPy, independent of the code under test."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra

RADIOMETER, PATH_GAIN, COMMON_GAIN = 0.045, 0.03, 0.02
N_LNA, N_RCU, N_ADC = 0.14, 4.6, 4.5


@dataclass(frozen=True)
class Scene:
    """What a test needs: the inputs of the fit and the truth behind the spectra."""

    instrument: Instrument
    sky_power: SkyPower
    n_lna: float = N_LNA
    n_rcu: float = N_RCU
    n_adc: float = N_ADC

    @cached_property
    def simulation(self) -> Simulation:
        return Simulation(self.instrument, self.sky_power)

    def slope(self, cable: str = "80") -> Floats:
        """s = G_ant L_coax G_RCU S with S = 1e4."""
        return self.instrument.antenna_gain * self.instrument.cables[cable] * self.instrument.receiver_gain * 1e4

    def mean_power(self, sky: Floats, cable: str = "80") -> Floats:
        """Noiseless recorded power for P_sky, shape (event, freq)."""
        return self.slope(cable) * (sky + self.n_lna) + self.n_rcu * self.instrument.receiver_gain + self.n_adc

    def draw(
        self, rng: np.random.Generator, paths: int, events: int, lst_range: tuple[float, float] = (0.0, 24.0)
    ) -> tuple[Floats, Floats, Floats]:
        """LST, P_sky at it and noisy power, shape (path, event, freq), of paths that share their events."""
        lst = rng.uniform(*lst_range, events)
        sky = self.sky_power.at("X", lst)
        gain = 1 + COMMON_GAIN * rng.standard_normal((1, events, 1))
        gain = gain + PATH_GAIN * rng.standard_normal((paths, events, 1))
        radiometer = rng.gamma(RADIOMETER**-2, RADIOMETER**2, (paths, events, sky.shape[1]))
        return lst, sky, self.mean_power(sky) * gain * radiometer

    def spectra(
        self, rng: np.random.Generator, events: int, antennas: int = 4, days: float = 365.0, stations: int = 1
    ) -> Spectra:
        """Spectra of stations' X and Y dipoles over `days` from 2014-01-01."""
        time_unix = 1_388_534_400.0 + np.sort(rng.uniform(0, days * 86_400, events))
        lst = local_sidereal_time(time_unix, self.instrument.longitude_deg)
        power, columns = [], []
        for station in [f"CS00{k + 2}" for k in range(stations)]:
            common = 1 + COMMON_GAIN * rng.standard_normal((events, 1))
            for antenna in range(antennas):
                for letter in ("X", "Y"):
                    sky = self.sky_power.at(letter, lst)
                    gain = common + PATH_GAIN * rng.standard_normal((events, 1))
                    radiometer = rng.gamma(RADIOMETER**-2, RADIOMETER**2, sky.shape)
                    power.append(self.mean_power(sky, "80" if antenna % 2 else "50") * gain * radiometer)
                    columns.append([(station, antenna, letter)] * events)
        keys = [key for column in columns for key in column]
        return Spectra(
            frequency_mhz=self.instrument.frequency_mhz,
            power=np.concatenate(power),
            event_id=np.tile([f"E{k:05d}" for k in range(events)], len(columns)),
            time_unix=np.tile(time_unix, len(columns)),
            station=np.array([key[0] for key in keys]),
            antenna=np.array([key[1] for key in keys]),
            dipole=np.array([key[2] for key in keys]),
            blocks=np.full(len(keys), 100),
        )


@pytest.fixture(scope="session")
def scene() -> Scene:
    frequency = np.arange(30.0, 81.0, 2.0)
    relative = frequency / 55.0
    lst = (np.arange(48) + 0.5) / 2
    phase = 2 * np.pi * lst[:, None] / 24
    power = {}
    for letter, lag in (("X", 0.0), ("Y", 0.3)):
        shape = 1 + 0.25 * relative**-0.2 * np.sin(phase - 1.9 - lag) - 0.1 * relative**0.3 * np.cos(2 * phase + lag)
        power[letter] = relative**-0.55 * shape
    instrument = Instrument(
        name="scene",
        latitude_deg=52.9,
        longitude_deg=6.87,
        height_m=50.0,
        frequency_mhz=frequency,
        dipole_azimuth_deg={"X": 45.0, "Y": 135.0},
        antenna_gain=0.003 + 1.3 / (1 + ((frequency - 58.0) / 4.0) ** 2),
        receiver_gain=1.15 / (1 + np.exp((frequency - 78.0) / 1.5)),
        cables={"50": 10 ** (-0.075 * frequency**0.5), "80": 10 ** (-0.12 * frequency**0.5)},
        antennas=tuple(
            AntennaRecord(station, antenna, "80" if antenna % 2 else "50")
            for station in ("CS002", "CS003")
            for antenna in range(4)
        ),
    )
    return Scene(instrument, SkyPower(frequency, lst, power, "scene"))


@pytest.fixture(scope="session")
def spectra(scene: Scene) -> Spectra:
    """400 events of two stations."""
    return scene.spectra(np.random.default_rng(11), events=400, stations=2)
