"""Whom a cause concerns: the paths of a station that share an effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.discovery.baseline import StationData


@dataclass(frozen=True)
class Target:
    """A set of paths: one path, an antenna, a cable name, or the station.

    Attributes
    ----------
    scope
        One of `lbacal_core.causes.terms.SCOPES`.
    label
        In words: ``antenna 17 X``, ``antenna 17``, ``cable 80``, ``station``.
    is_member
        Shape (path,).
    """

    scope: str
    label: str
    is_member: NDArray[np.bool_]


def list_targets(data: StationData) -> list[Target]:
    """Every path, antenna and cable name of a station, and the station; sets that coincide are named once."""
    paths = len(data.antenna)
    targets = []
    if paths > len(np.unique(data.dipole)):
        targets += [
            Target("path", f"antenna {data.antenna[k]} {data.dipole[k]}", np.arange(paths) == k) for k in range(paths)
        ]
        for antenna in np.unique(data.antenna):
            is_member = data.antenna == antenna
            if is_member.sum() > 1:
                targets.append(Target("antenna", f"antenna {antenna}", is_member))
    cables = np.array(data.conditions.cables)[data.class_of]
    names = np.unique(cables)
    if len(names) > 1:
        targets += [
            Target("cable", f"cable {name}", cables == name) for name in names if (cables == name).sum() < paths
        ]
    return [*targets, Target("station", "station", np.ones(paths, dtype=bool))]
