"""What faults follow in time: temperature, season, rain, a date."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_twin.settings import YEAR_S
from lbacal_twin.stages import Scene

FOLLOWED = ("temperature", "season", "wet", "rain", "soaked")


def driver(follows: str, scene: Scene) -> Floats:
    """How strongly a fault acts at each event, shape (event, 1).

    ``temperature``: in units of 10 K above 10 degrees; ``season``: 1 on 21 July, -1 half a year apart; ``wet``: 1 in
    any rain; ``rain``: the intensity in mm/h; ``soaked``: tanh of the intensity, which saturates.
    """
    if follows == "temperature":
        return scene.warmth
    if follows == "season":
        return np.cos(2 * np.pi * (scene.time_unix[:, None] % YEAR_S / YEAR_S - 0.55))
    rain = scene.rain_mm_h[:, None]
    if follows == "wet":
        return (rain > 0).astype(float)
    if follows == "rain":
        return rain
    if follows == "soaked":
        return np.tanh(rain)
    raise UnknownNameError("driver", follows, list(FOLLOWED))


def since(date: str, scene: Scene) -> Floats:
    """1 for events from an ISO date (UTC) on, 0 before; shape (event, 1)."""
    instant = datetime.fromisoformat(date)
    instant = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
    return (scene.time_unix[:, None] >= instant.timestamp()).astype(float)


def between_hours(first: float, last: float, scene: Scene) -> Floats:
    """1 for events between two UTC hours of day, past midnight if `last` is smaller; shape (event, 1)."""
    duration = 24.0 if last - first == 24.0 else (last - first) % 24.0
    return ((scene.utc_hours - first) % 24.0 < duration).astype(float)
