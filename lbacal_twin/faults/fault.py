"""What a fault is: something in the sky, the ground or the electronics that the model of the data leaves out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.stages import Scene, Stages


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
        """What is planted, for the sealed truth."""
        return {"fault": type(self).__name__, **asdict(self)}
