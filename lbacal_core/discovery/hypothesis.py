"""A hypothesis: a cause, one template of its family, a target (the affected paths), and a size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.station import Station


@dataclass(frozen=True)
class Target:
    """A set of paths: one path, an antenna, antennas that share hardware, a cable name, or the station.

    Attributes
    ----------
    scope
        One of `lbacal_core.causes.cause.SCOPES`.
    label
        In words: ``antenna 17 X``, ``antenna 17``, ``group board 3``, ``cable 80``, ``station``.
    is_member
        Shape (path,).
    """

    scope: str
    label: str
    is_member: NDArray[np.bool_]

    @property
    def is_wide(self) -> bool:
        """Whether it is more than an antenna, so that the mean of the station shows its effect."""
        return self.scope in ("station", "cable", "group")


@dataclass(frozen=True)
class Hypothesis:
    """A cause with a template for a target, at a size.

    Attributes
    ----------
    sigma
        Standard deviation of the size for this template.
    template_sigma
        Scatter of the size among the templates that the data leave open, as a fraction of the size.
    """

    cause: Cause
    template: Template
    target: Target
    size: float
    sigma: float = np.inf
    template_sigma: float = 0.0

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the size, including the scatter among templates that the data leave open."""
        return float(np.hypot(self.sigma, self.template_sigma * self.size))


def list_targets(station: Station) -> list[Target]:
    """Every path, antenna, cable name and group of a station, and the station."""
    paths = len(station.antenna)
    targets = []
    if paths > len(np.unique(station.dipole)):
        for k in range(paths):
            label = f"antenna {station.antenna[k]} {station.dipole[k]}"
            targets.append(Target("path", label, np.arange(paths) == k))
        for antenna in np.unique(station.antenna):
            is_member = station.antenna == antenna
            if is_member.sum() > 1:
                targets.append(Target("antenna", f"antenna {antenna}", is_member))
    cables = np.array(station.conditions.cables)[station.class_of]
    for scope, names in (("cable", cables), ("group", station.group)):
        for name in np.unique(names[names != ""]):
            is_member = names == name
            is_antenna = scope == "group" and np.unique(station.antenna[is_member]).size == 1
            if not np.all(is_member) and not is_antenna:
                targets.append(Target(scope, f"{scope} {name}", is_member))
    return [*targets, Target("station", "station", np.ones(paths, dtype=bool))]
