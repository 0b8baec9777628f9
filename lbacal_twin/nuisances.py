"""What real campaigns look like without anything being wrong: gaps, dead antennas, uneven hours, unequal antennas."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.hardware import Stages


@dataclass(frozen=True)
class Nuisances:
    """How unlike a textbook a campaign is; none of it is a fault.

    Attributes
    ----------
    missing
        Fraction of (event, station) that were not read out, and again of single paths.
    dead_antennas
        Antennas of each station that fall silent for good on a random date.
    thin_lst_hours, thin
        Half of the width and depth of a part of the sidereal day with fewer events: at a random LST, only a fraction
        1 - `thin` of the events within `thin_lst_hours` of it is kept.
    noisy_stations, noise_factor
        Names of stations whose scatter is larger by that factor.
    departures
        Spread from path to path, of zero mean, of each noise level, of the gain behind N_RCU, and of A along
        frequency: as a fraction of power (levels: three times that).
    mismatch
        Spread from path to path of what the antenna hands to its amplifier, r.m.s. along frequency of ln power. Its
        forms are those of measured antennas: 0.02-0.05 at one station of the LWA, 0.13-0.23 at another.
    sky_correlation
        Part of the radiometer variance that all antennas of a station share, because they see the same sky.
    deaf_antennas
        Antennas of each station whose amplifiers are broken: they receive `DEAF_GAIN` of what the others do.
    clustered
        Fraction of the events that fall into observing runs of a few days.
    interference
        Lines an event that were not removed, at a random channel each, seen by all antennas of a station.
    """

    missing: float = 0.0
    dead_antennas: int = 0
    thin_lst_hours: float = 2.0
    thin: float = 0.0
    noisy_stations: tuple[str, ...] = ()
    noise_factor: float = 1.5
    departures: float = 0.0
    mismatch: float = 0.0
    sky_correlation: float = 0.0
    deaf_antennas: int = 0
    clustered: float = 0.0
    interference: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "missing": 0.9,
            "thin": 1.0,
            "departures": 0.2,
            "mismatch": 0.5,
            "sky_correlation": 0.9,
            "clustered": 1.0,
        }
        for field, limit in limits.items():
            if not 0 <= getattr(self, field) <= limit:
                raise BadInputError(
                    f"twin nuisances: {field}", f"a fraction, 0 to {limit:g}", f"{getattr(self, field)}"
                )

    def as_dict(self) -> dict[str, Any]:
        """Describe the nuisances as JSON values."""
        return asdict(self) | {"noisy_stations": list(self.noisy_stations)}


DEAF_GAIN = 0.03
"""Power gain of a deaf antenna over that of the others: the coupling into a broken amplifier."""
RESIDUAL_LINE = 0.03
"""Mean power of a line that was not removed, as a fraction of the power of its channel."""

NONE = Nuisances()
REALISTIC = Nuisances(
    missing=0.05, dead_antennas=2, thin=0.6, noisy_stations=("CS003",), departures=0.01, sky_correlation=0.01
)


def depart(stages: Stages, size: float, rng: np.random.Generator) -> Stages:
    """The stages with every path a little different from the next, in ways that the station's model does not know."""
    antennas, dipoles = stages.gain.shape[:2]
    channels = stages.antenna.shape[3]

    def spread(width: float) -> Floats:
        return np.asarray(1.0 + rng.normal(scale=width, size=(antennas, dipoles, 1, 1)))

    wave = np.cos(np.pi * np.outer(np.linspace(0.0, 1.0, channels), [1, 2, 3, 4]))
    own = rng.normal(scale=size / 2**0.5, size=(antennas, dipoles, 1, 4)) @ wave.T
    return replace(
        stages,
        lna_noise=stages.lna_noise * spread(3 * size),
        rcu_noise=stages.rcu_noise * spread(3 * size),
        adc_noise=stages.adc_noise * spread(3 * size),
        receiver=stages.receiver * spread(size),
        antenna=stages.antenna * (1.0 + own),
    )


def mismatch_antennas(stages: Stages, frequency_mhz: Floats, size: float, rng: np.random.Generator) -> Stages:
    """The stages with antennas as unlike as measured ones: sums of their forms, each of r.m.s. 1 on these channels."""
    table = np.loadtxt(str(files("lbacal_twin") / "mismatch.csv"), delimiter=",", skiprows=2)
    forms = np.array([np.interp(frequency_mhz, table[:, 0], column) for column in table[:, 1:].T])
    forms /= np.sqrt(np.mean(forms**2, axis=1, keepdims=True) * len(forms))
    drawn = rng.normal(scale=size, size=(*stages.gain.shape[:2], 1, len(forms))) @ forms
    return replace(stages, antenna=stages.antenna * np.exp(drawn))


def deafen(stages: Stages, count: int, rng: np.random.Generator) -> Stages:
    """The stages with some antennas that hardly receive the sky, from the first event on."""
    antennas = stages.gain.shape[0]
    gain = stages.gain.copy()
    gain[rng.choice(antennas, size=min(count, antennas - 1), replace=False)] *= DEAF_GAIN
    return replace(stages, gain=gain)


def add_interference(power: Floats, lines_an_event: float, rng: np.random.Generator) -> None:
    """Add narrow lines to a power of shape (antenna, dipole, event, freq), in place.

    A line lies in one channel of one event, and reaches every path with a strength of its own.
    """
    antennas, dipoles, events, channels = power.shape
    lines = rng.poisson(lines_an_event * events)
    event, channel = rng.integers(events, size=lines), rng.integers(channels, size=lines)
    strength = rng.exponential(RESIDUAL_LINE, size=lines) * rng.uniform(0.5, 1.5, size=(antennas, dipoles, lines))
    power[:, :, event, channel] *= 1.0 + strength


def lose_spectra(spectra: Spectra, nuisances: Nuisances, longitude_deg: float, rng: np.random.Generator) -> Spectra:
    """The spectra that remain of a campaign with gaps, dead antennas and uneven coverage."""
    keep = np.ones(len(spectra), dtype=bool)
    events, event = np.unique(spectra.event_id, return_inverse=True)
    stations, station = np.unique(spectra.station, return_inverse=True)
    keep &= rng.random((events.size, stations.size))[event, station] >= nuisances.missing
    keep &= rng.random(len(spectra)) >= nuisances.missing
    centre = rng.uniform(0.0, 24.0)
    distance = np.abs((local_sidereal_time(spectra.time_unix, longitude_deg) - centre + 12.0) % 24.0 - 12.0)
    is_thinned = rng.random(events.size)[event] < nuisances.thin
    keep &= ~(is_thinned & (distance < nuisances.thin_lst_hours))
    first, last = spectra.time_unix.min(), spectra.time_unix.max()
    for name in stations:
        antennas = np.unique(spectra.antenna[spectra.station == name])
        for antenna in rng.choice(antennas, size=min(nuisances.dead_antennas, antennas.size - 1), replace=False):
            death = rng.uniform(first, last)
            keep &= ~((spectra.station == name) & (spectra.antenna == antenna) & (spectra.time_unix >= death))
    return spectra.select(keep)
