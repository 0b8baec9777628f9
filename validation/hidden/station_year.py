"""A station-year as drawn worlds have it: large enough to see a wrong sky, with everything that a year brings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_twin.nuisances import REALISTIC

STATION = "CS002"
ANTENNAS, WHOLE_STATION = tuple(range(12)), tuple(range(48))
WHOLE_SHARE = 0.1
"""Share of the data sets in which all antennas of the station are there."""
EVENTS = 900
EVERYTHING = replace(REALISTIC, dead_antennas=1, deaf_antennas=1, clustered=0.6, interference=0.2)
"""5 % of the spectra missing, one dead and one deaf antenna, events in runs, lines that were left, unequal antennas."""


def draw_antennas(seed: int) -> tuple[int, ...]:
    """The antennas of a data set: twelve, or the whole station."""
    is_whole = np.random.default_rng([20261122, 48, seed]).random() < WHOLE_SHARE
    return WHOLE_STATION if is_whole else ANTENNAS
