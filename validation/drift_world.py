"""An array that ages, drawn without the detector: what seven years of events tell of every path's ln C.

A campaign has a level of every year that all paths share (5 %, the scatter of the paper), a season that all share (3 %)
and one of each path's own, of any phase and not quite a sine, gains of events that a station shares, gains of a path's
own with the tails of Student's t with five degrees of freedom, noise of the two modes along frequency, weather that
lasts for days, offsets of the reference curves, spectra that are missing and stations that are silent for months.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.drift.follow import History
from lbacal_core.grids import Floats

DAY = 86_400.0
YEAR = 365.2422 * DAY
START = 1_325_376_000.0
MODES = 3


@dataclass(frozen=True)
class World:
    """How large the campaign is and what moves in it; sizes are changes of ln C.

    Attributes
    ----------
    yearly
        Scatter of the whole from year to year; `is_smooth` lets it change between the years instead of at them.
    season
        Amplitude that all share, and the largest amplitude of a path's own.
    event_of_station, event_of_path, event_of_mode
        Standard deviations in one event.
    weather
        Standard deviation of a path's own process with a length of four days.
    """

    years: float = 7.0
    stations: int = 6
    antennas: int = 48
    events_per_year: int = 900
    yearly: float = 0.05
    is_smooth: bool = False
    season: float = 0.03
    event_of_station: float = 0.0175
    event_of_path: float = 0.0175
    event_of_mode: float = 0.008
    weather: float = 0.002
    trend: float = 0.0

    @property
    def names(self) -> Sequence[str]:
        """The stations."""
        return [f"CS{number:03d}" for number in range(2, 2 + self.stations)]


def draw_history(world: World, rng: np.random.Generator) -> History:
    time_unix = np.sort(START + rng.uniform(0.0, world.years * YEAR, rng.poisson(world.years * world.events_per_year)))
    station = np.repeat(world.names, 2 * world.antennas)
    antenna = np.tile(np.repeat(np.arange(world.antennas), 2), world.stations)
    paths, events = station.size, time_unix.size
    phase = 2 * np.pi * (time_unix - START) / YEAR
    ln_c = np.empty((paths, events, MODES), dtype=np.float32)
    ln_c[..., 1:] = world.event_of_mode * rng.standard_normal((paths, events, MODES - 1), dtype=np.float32)
    shared = _draw_years(world, time_unix, rng) + world.trend * (time_unix - START) / YEAR
    shared += world.season * np.cos(phase - rng.uniform(0, 2 * np.pi))
    of_station = shared + world.event_of_station * rng.standard_normal((world.stations, events))
    ln_c[..., 0] = np.repeat(of_station, 2 * world.antennas, axis=0)
    ln_c[..., 0] += world.event_of_path * np.sqrt(3 / 5) * rng.standard_t(5, (paths, events))
    amplitude, own = world.season * rng.uniform(0, 1, (paths, 1)), phase - rng.uniform(0, 2 * np.pi, (paths, 1))
    season = amplitude * (np.cos(own) + 0.2 * np.cos(2 * own + 1.0) + 0.03 * np.cos(3 * own))
    days = ((time_unix - START) / (4 * DAY)).astype(int)
    season += world.weather * rng.standard_normal((paths, days.max() + 1))[:, days]
    ln_c += (season[..., None] * np.array([1.0, 0.3, -0.1])).astype(np.float32)
    ln_c += 0.005 * rng.standard_normal((paths, 1, MODES), dtype=np.float32)
    ln_c[rng.uniform(size=(paths, events)) < 0.03] = np.nan
    for name in rng.choice(world.names, 2):
        begin = START + rng.uniform(0.0, world.years) * YEAR
        silent = (time_unix >= begin) & (time_unix < begin + 75 * DAY)
        ln_c[np.ix_(station == name, silent)] = np.nan
    dipole = np.tile(["X", "Y"], world.stations * world.antennas)
    return History(station, antenna, dipole, time_unix, ln_c, np.full((paths, 0), np.inf))


def _draw_years(world: World, time_unix: Floats, rng: np.random.Generator) -> Floats:
    """Levels of the years at some times, in steps at the turns of the year or smooth between their middles."""
    years = (time_unix - START) / YEAR
    level = world.yearly * rng.standard_normal(int(world.years) + 2)
    if world.is_smooth:
        return np.asarray(np.interp(years + 0.5, np.arange(level.size), level))
    return np.asarray(level[years.astype(int)])


def cut_short(history: History, years: float) -> History:
    events = int(np.searchsorted(history.time_unix, START + years * YEAR))
    return History(
        history.station, history.antenna, history.dipole, history.time_unix[:events], history.ln_c[:, :events],
        history.known_unix,
    )  # fmt: skip
