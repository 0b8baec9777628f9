"""What a fault is: something in the sky, the ground or the electronics that the model of the data leaves out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import YEAR_S


@dataclass(frozen=True)
class Where:
    """The paths that a fault touches; an empty choice means all.

    Attributes
    ----------
    stations, antennas, cables, dipoles
        Names or numbers; a path is touched when it is in every choice made.
    """

    stations: tuple[str, ...] = ()
    antennas: tuple[int, ...] = ()
    cables: tuple[str, ...] = ()
    dipoles: tuple[str, ...] = ()

    def mask(self, scene: Scene) -> Floats:
        """1 for a path that is touched, 0 for the others; shape (antenna, dipole, 1, 1)."""
        is_antenna = np.isin(scene.antennas, self.antennas) | (not self.antennas)
        is_antenna &= np.isin(scene.cables, self.cables) | (not self.cables)
        is_antenna &= scene.station in (self.stations or (scene.station,))
        is_dipole = np.isin(scene.dipoles, self.dipoles) | (not self.dipoles)
        return np.outer(is_antenna, is_dipole).astype(float)[:, :, None, None]


EVERYWHERE = Where()


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that is wrong, of some size, on some paths.

    A fault acts on the stages of the chain, or on the power that reaches the converter, or on both. The order of
    the list in which faults are planted is the order in which they act.
    """

    size: float
    where: Where = EVERYWHERE

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """The stages of the chain with the fault."""
        del scene
        return stages

    def alter_at_converter(self, power: Floats, scene: Scene) -> Floats:
        """The power that reaches the converter with the fault; shape (antenna, dipole, event, freq)."""
        del scene
        return power

    def as_dict(self) -> dict[str, Any]:
        """The fault as JSON values, for the sealed truth."""
        return {"fault": type(self).__name__, **asdict(self)}


# What faults follow in time: temperature, season, rain, a date.

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
