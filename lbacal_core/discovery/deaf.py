"""Paths that hardly hear the sky: their antenna or its amplifier is broken, and they are left out of a search.

The sky is a smaller share of their power than of that of the others. What a wrong sky does to it therefore does not
cancel in their deviation from the mean, where the differences between sky models are not profiled out, and takes the
form of a cause.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

SMALLEST_SHARE = 0.3
"""Share of the sky in the power of a path, over the median of all paths. The longest cables have 0.6 to 0.7 of it, deaf
ones in drawn worlds 0.04 to 0.23, and a path whose gain falls by 0.4 of its excess power seems to have 0.34 to 0.5."""


def leave_out_deaf(station: Station) -> tuple[Station, list[str]]:
    """The station without the paths that hardly hear the sky, and their names; a class keeps one path at least."""
    share = sky_shares(station)
    is_kept = share >= SMALLEST_SHARE * np.median(share)
    for c in range(len(station.conditions.dipoles)):
        own = station.class_of == c
        if not np.any(is_kept[own]):
            is_kept |= own
    deaf = np.flatnonzero(~is_kept).tolist()
    names = [f"antenna {station.antenna[k]} {station.dipole[k]}" for k in deaf]
    return (station if not deaf else _select(station, is_kept)), names


def sky_shares(station: Station) -> Floats:
    """Median over the channels of the share of the sky in the power of each path, shape (path,)."""
    solution = fit_baseline(station).solution
    terms = station.conditions.intercepts
    sky = station.sky.mean(axis=1)[station.class_of] * solution.x
    power = sky + terms.before(solution.n) * solution.x + solution.q @ terms.behind
    return np.asarray(np.median(sky / power, axis=1))


def _select(station: Station, kept: NDArray[np.bool_]) -> Station:
    return replace(
        station,
        antenna=station.antenna[kept],
        dipole=station.dipole[kept],
        class_of=station.class_of[kept],
        group=station.group[kept],
        power=station.power[kept],
        relative_variance=station.relative_variance[kept],
    )
