"""When the events of a campaign happen, and the weather at those instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.settings import DAY_S, YEAR_S

MEAN_C, SEASON_C, DAILY_C, PASSING_C = 10.0, 7.5, 4.0, 3.0
"""Mean, half ranges of season and day, and spread of passing weather: the climate of Drenthe, rounded."""
COLDEST_DAY, WARMEST_HOUR = 20.0, 15.0
WET_HOURS = 0.08
"""Fraction of hours with rain."""
SPELL_S = 10_800.0
"""Rain comes in spells of three hours."""
HEAVY_MM_H = 1.5
"""Mean intensity of a wet hour."""
RUNS_A_YEAR, RUN_S = 25, 3 * DAY_S
"""Observing runs, into which the events of real campaigns cluster."""


def draw_event_times(
    start_unix: float, years: float, count: int, rng: np.random.Generator, clustered: float = 0.0
) -> Floats:
    """Instants of `count` events of the campaign, no two in the same UTC second.

    Parameters
    ----------
    clustered
        Fraction of the events that fall into runs of three days, 25 a year; the others are uniform.

    Returns
    -------
    Shape (event,), s UTC, rising.
    """
    whole = int(years * YEAR_S)
    if clustered > 0:
        begins = rng.integers(0, whole - round(RUN_S), size=max(1, round(RUNS_A_YEAR * years)))
        seconds = np.empty(0, dtype=np.int64)
        while seconds.size < count:
            in_run = begins[rng.integers(begins.size, size=2 * count)] + rng.integers(round(RUN_S), size=2 * count)
            tried = np.where(rng.random(2 * count) < clustered, in_run, rng.integers(whole, size=2 * count))
            seconds = np.unique(np.concatenate([seconds, tried]))
        seconds = rng.choice(seconds, size=count, replace=False)
    else:
        seconds = rng.choice(whole, size=count, replace=False)
    return np.sort(start_unix + seconds + rng.random(count))


@dataclass(frozen=True)
class Weather:
    """The weather of a campaign at any instant of it, also between the events.

    Attributes
    ----------
    first_day
        Days since 1970 of the first entry of `passing`.
    passing
        Shape (day,), temperature of passing weather in units of its spread.
    rain_mm_h
        Shape (spell,), intensity in each spell of three hours from `first_day` on, 0 when dry.
    """

    longitude_deg: float
    first_day: int
    passing: Floats
    rain_mm_h: Floats

    def temperature_at(self, time_unix: Floats) -> Floats:
        """Air temperature: season, time of day, and weather that passes within days; degrees Celsius."""
        day = time_unix / DAY_S
        season = -np.cos(2 * np.pi * (time_unix % YEAR_S - COLDEST_DAY * DAY_S) / YEAR_S)
        hour = (time_unix / 3600.0 + self.longitude_deg / 15.0) % 24.0
        daily = np.cos(2 * np.pi * (hour - WARMEST_HOUR) / 24.0)
        passing = np.interp(day, self.first_day + np.arange(self.passing.size), self.passing)
        return np.asarray(MEAN_C + SEASON_C * season + DAILY_C * daily + PASSING_C * passing)

    def rain_at(self, time_unix: Floats) -> Floats:
        """Rain, mm per hour, 0 when dry."""
        spell = np.floor(time_unix / SPELL_S).astype(np.int64) - self.first_day * round(DAY_S / SPELL_S)
        return np.asarray(self.rain_mm_h[np.clip(spell, 0, self.rain_mm_h.size - 1)])


def draw_weather(time_unix: Floats, longitude_deg: float, rng: np.random.Generator) -> Weather:
    """Draw the weather from five days before the first instant to two days after the last."""
    first, last = int(time_unix.min() / DAY_S) - 5, int(time_unix.max() / DAY_S) + 2
    days = last - first
    smoothing = np.array([0.25, 0.5, 0.75, 0.5, 0.25])
    passing = np.convolve(rng.normal(size=days + 4), smoothing / np.sqrt(np.sum(smoothing**2)), mode="valid")
    spells = days * round(DAY_S / SPELL_S)
    is_wet = rng.random(spells) < WET_HOURS
    return Weather(longitude_deg, first, passing, np.where(is_wet, rng.exponential(HEAVY_MM_H, size=spells), 0.0))
