"""The world of a data set, and what the finder may know of it: never the sky or the antenna that were drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np

from lbacal_core.antenna.names import DEFAULT_ANTENNA
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.sky.differences import SIMULATED_LBA as SIMULATED_NAME
from lbacal_core.sky.differences import DifferenceModels, waves_at
from lbacal_core.sky.names import DEFAULT_SKY, load_sky
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_twin.nuisances import REALISTIC
from lbacal_twin.view import View
from lbacal_twin.world import ANTENNAS, MADE_OF, SKIES, World, draw_world
from validation.machinery.parts import SHARED
from validation.superterp import power_of, superterp

SIMULATED_LBA = SHARED / "data" / "antenna" / "lba_vout.npz"
"""A simulated antenna that may not ship: it joins the antennas that are drawn where the folder ../shared is present."""
LEVEL_DEGREE, LEVEL_PRIOR = 3, 0.1
"""Degree of the Legendre polynomials in ln nu of a level that is free, and the standard deviation of each."""


STATION = "CS002"
TWELVE, WHOLE_STATION = tuple(range(12)), tuple(range(48))
WHOLE_SHARE = 0.1
"""Share of the data sets in which all antennas of the station are there."""
EVENTS = 900
EVERYTHING = replace(REALISTIC, dead_antennas=1, deaf_antennas=1, clustered=0.6, interference=0.2)
"""5 % of the spectra missing, one dead and one deaf antenna, events in runs, lines that were left, unequal antennas."""


def draw_antennas(seed: int) -> tuple[int, ...]:
    """The antennas of a data set: twelve, or the whole station."""
    is_whole = np.random.default_rng([20261122, 48, seed]).random() < WHOLE_SHARE
    return WHOLE_STATION if is_whole else TWELVE


@dataclass(frozen=True)
class Finder:
    """The sky and the antenna with which the finder simulates."""

    sky: str = DEFAULT_SKY
    antenna: str = DEFAULT_ANTENNA

    def power(self) -> SkyPower:
        """P_sky as the finder has it, for the Superterp."""
        return power_of(self.sky, self.antenna)


OWN = Finder()
"""The finder with the sky and the antenna that the package takes unless told otherwise."""


def draw(seed: int, finder: Finder) -> World:
    """The world of a data set: a sky and an antenna that are not the finder's."""
    rng = np.random.default_rng([20261122, seed])
    antennas = [*ANTENNAS, *([str(SIMULATED_LBA)] if SIMULATED_LBA.is_file() else [])]
    return draw_world(rng, _without(SKIES, finder.sky), _without(antennas, finder.antenna))


def alternatives(world: World, finder: Finder) -> DifferenceModels:
    """Models that the finder may know: all that ship but for its own, and but for those that were drawn.

    Where a sky is made of others, the first one, which gives it what the others do not have, is left out as well.
    """
    drawn = {world.sky, *MADE_OF.get(world.sky, ())[:1], finder.sky}
    skies = tuple(name for name in SKIES if name not in drawn | set(MADE_OF))
    antennas = (SIMULATED_NAME, *(name for name in ANTENNAS if name not in {world.antenna, finder.antenna}))
    return DifferenceModels(skies, antennas[1:] if world.antenna == str(SIMULATED_LBA) else antennas)


def free_modes(finder: Finder, known: DifferenceModels, lst_hours: Floats) -> Floats:
    """Changes of ln P_sky that are free to a finder who knows these models, each one standard deviation.

    A smooth level, constant in LST and the same in both polarisations; an isotropic brightness with a smooth spectrum;
    in each polarisation the change along LST that each exchange of a sky or of the antenna makes; and the waves along
    LST that no model need have.

    Returns
    -------
    Shape (mode, dipole, event, freq).
    """
    frequency = superterp().frequency_mhz
    x = np.log(frequency)
    polynomials = np.polynomial.legendre.legvander(2 * (x - x[0]) / (x[-1] - x[0]) - 1, LEVEL_DEGREE).T
    shape = (len(polynomials), len(DIPOLES), lst_hours.size, frequency.size)
    modes = [np.broadcast_to(LEVEL_PRIOR * polynomials[:, None, None], shape)]
    brighter = _at(_with_isotropic(finder.sky, finder.antenna), lst_hours)
    base = _at(finder.power(), lst_hours)
    modes.append((brighter / base - 1.0) * polynomials[:, None, None])
    of_each = np.eye(len(DIPOLES))[:, :, None, None]
    exchanged = [(sky, finder.antenna) for sky in known.skies] + [
        (finder.sky, str(SIMULATED_LBA) if antenna == SIMULATED_NAME else antenna)
        for antenna in known.antennas
        if antenna != SIMULATED_NAME or SIMULATED_LBA.is_file()
    ]
    for pair in exchanged:
        change = np.log(_at(power_of(*pair), lst_hours) / base)
        change -= change.mean(axis=1, keepdims=True)
        modes.append(change * of_each)
    together, own = waves_at(frequency, lst_hours, is_search=True)
    modes.append(np.broadcast_to(together.changes[:, None], (len(together.profile), *shape[1:])))
    modes.append((own.changes[:, None, None] * of_each).reshape(-1, *shape[1:]))
    return np.concatenate(modes)


def _at(power: SkyPower, lst_hours: Floats) -> Floats:
    return np.stack([power.at(dipole, lst_hours) for dipole in DIPOLES])


@cache
def _with_isotropic(sky: str, antenna: str) -> SkyPower:
    return compute_sky_power(superterp(), load_sky(sky).changed(extra_isotropic=1.0), antenna)


@lru_cache(maxsize=8)
def view_of(sky: str, antenna: str) -> View:
    """The sky by direction; made once in each process, because the first fault with a direction takes seconds."""
    return World(sky, antenna, "behind").view(superterp())


def _without(names: Sequence[str], own: str) -> list[str]:
    return [name for name in names if name != own]
