"""When the events of a campaign happen, and the weather at those instants."""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats

DAY_S = 86_400.0
YEAR_S = 365.25 * DAY_S
MEAN_C, SEASON_C, DAILY_C, PASSING_C = 10.0, 7.5, 4.0, 3.0
"""Mean, half ranges of season and day, and spread of passing weather: the climate of Drenthe, rounded."""
COLDEST_DAY, WARMEST_HOUR = 20.0, 15.0
WET_HOURS = 0.08
"""Fraction of hours with rain."""
HEAVY_MM_H = 1.5
"""Mean intensity of a wet hour."""


def draw_event_times(start_unix: float, years: float, count: int, rng: np.random.Generator) -> Floats:
    """Instants of `count` events, uniform over the campaign, at least one in different UTC seconds each.

    Returns
    -------
    Shape (event,), s UTC, rising.
    """
    seconds = rng.choice(int(years * YEAR_S), size=count, replace=False)
    return np.sort(start_unix + seconds + rng.random(count))


def draw_temperature(time_unix: Floats, longitude_deg: float, rng: np.random.Generator) -> Floats:
    """Air temperature: season, time of day, and weather that passes within days.

    Returns
    -------
    Shape (event,), degrees Celsius.
    """
    day = time_unix / DAY_S
    season = -np.cos(2 * np.pi * (time_unix % YEAR_S - COLDEST_DAY * DAY_S) / YEAR_S)
    hour = (time_unix / 3600.0 + longitude_deg / 15.0) % 24.0
    daily = np.cos(2 * np.pi * (hour - WARMEST_HOUR) / 24.0)
    first, last = int(day.min()) - 1, int(day.max()) + 2
    weather = rng.normal(size=last - first + 4)
    weather = np.convolve(weather, [0.25, 0.5, 0.75, 0.5, 0.25], mode="valid") / 1.0897
    passing = np.interp(day, np.arange(first, last), weather)
    return MEAN_C + SEASON_C * season + DAILY_C * daily + PASSING_C * passing


def draw_rain(time_unix: Floats, rng: np.random.Generator) -> Floats:
    """Rain: hours are wet by chance, with an exponential intensity; an hour's neighbours share it often.

    Returns
    -------
    Shape (event,), mm per hour, 0 when dry.
    """
    spell = (time_unix // 10_800.0).astype(np.int64)
    first = int(spell.min())
    length = int(spell.max()) - first + 1
    wet = rng.random(length) < WET_HOURS
    intensity = rng.exponential(HEAVY_MM_H, size=length)
    return np.asarray(np.where(wet, intensity, 0.0)[spell - first], dtype=float)
