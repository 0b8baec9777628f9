"""The world of a campaign: which sky and antenna it has, and how its events' gains act, drawn anew for every data set.

A sky is one of the models by name, or made of them; a third of the skies lies outside every model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_twin.gains import NOISES, EventGains
from lbacal_twin.view import View

MADE_OF: Mapping[str, tuple[str, ...]] = {"half": ("lfsm", "gsm408"), "edges": ("gsm408",)}
"""Skies that are made of others, the model first that they are nearest to in what they have of their own."""
SKIES = ("gsm", "gsm408", "lfsm", "haslam", "maeda", *MADE_OF)
ANTENNAS = ("hamaker", "inverted-v", "inverted-v-wet")
EDGES_SCALE, EDGES_INDEX = 1.128, 0.114
"""Level at 60 MHz, and further spectral index, of what EDGES measured over the Global Sky Model: 1.15, 1.13, 1.10 and
1.09 at 50, 60, 75 and 80 MHz (Mozdzen et al. 2019, MNRAS 483, 4411; Monsalve et al. 2021, ApJ 908, 145)."""
OUTSIDE = ("index", "zero level", "level", "lst")
"""Ways to lie outside every model."""
INDEX_SPREAD, INDEX_LMAX, PIVOT_MHZ = 0.05, 3, 55.0
"""R.m.s. over the sky of the spectral index beyond that of the model, and its highest multipole."""
ZERO_LEVEL, LEVEL, LST_RMS = 0.2, 0.15, 0.03
"""Largest isotropic level in units of the extragalactic one, 270 K at 45 MHz, where maps were corrected by 160 +- 78 K
(Monsalve et al. 2021); largest change of the level; r.m.s. of harmonics 1 to 3 of the sidereal day."""
HARMONICS = 3
SIDE = 32


@dataclass(frozen=True)
class World:
    """A sky, an antenna, and the form of the gains of events.

    Attributes
    ----------
    sky, antenna
        Names; an antenna may be a file.
    noise
        A name of `NOISES`.
    outside
        How the sky lies outside every model: one of `OUTSIDE`, empty if it does not.
    number
        Seed of what is random in that.
    """

    sky: str
    antenna: str
    noise: str
    outside: str = ""
    number: int = 0

    @property
    def gains(self) -> EventGains:
        """Where the gains of events act."""
        return NOISES[self.noise]

    @property
    def models(self) -> tuple[str, str]:
        """Names of sky and antenna, what is random in the sky left out."""
        return self.sky, self.antenna

    def sky_model(self) -> SkyModel:
        """The sky, but for what is added to P_sky itself."""
        sky, rng = make_sky(self.sky), np.random.default_rng([20261122, self.number])
        if self.outside == "index":
            return tilt(sky, rng)
        if self.outside == "zero level":
            return sky.changed(extra_isotropic=float(rng.uniform(-ZERO_LEVEL, ZERO_LEVEL)))
        if self.outside == "level":
            return sky.changed(scale=float(np.exp(rng.uniform(-LEVEL, LEVEL))))
        return sky

    def sky_power(self, instrument: Instrument) -> SkyPower:
        """P_sky of the world."""
        power = compute_sky_power(instrument, self.sky_model(), self.antenna)
        if self.outside != "lst":
            return power
        rng = np.random.default_rng([20261122, self.number])
        factor = 1.0 + _waves(power.lst_hours, rng)[:, None]

        def waved(one: SkyPower) -> SkyPower:
            stations = {name: waved(other) for name, other in one.stations.items()}
            return replace(one, power={name: values * factor for name, values in one.power.items()}, stations=stations)

        return waved(power)

    def view(self, instrument: Instrument) -> View:
        """The sky by direction; what is random in the sky changes its ratios by less than their sizes are known."""
        return View(instrument, make_sky(self.sky), load_antenna(self.antenna))

    @property
    def label(self) -> str:
        """In words."""
        sky = f"{self.sky}, {self.outside}" if self.outside else self.sky
        return f"{sky} / {self.antenna.rpartition('/')[2]} / {self.noise}"


def draw_world(rng: np.random.Generator, skies: Sequence[str], antennas: Sequence[str]) -> World:
    """Draw a sky, an antenna and a form of the event gains; one sky in three lies outside every model."""
    outside = str(rng.choice(OUTSIDE)) if rng.random() < 1 / 3 else ""
    sky, antenna, noise = (str(rng.choice(list(names))) for names in (skies, antennas, NOISES))
    return World(sky, antenna, noise, outside, int(rng.integers(2**31)))


def make_sky(name: str) -> SkyModel:
    """A sky model by name, or one that is made of others."""
    if name == "half":
        return _mixture(*(load_sky(part) for part in MADE_OF[name]))
    if name == "edges":
        return load_sky(MADE_OF[name][0]).changed(scale=EDGES_SCALE, spectral_index=EDGES_INDEX)
    if name in SKIES:
        return load_sky(name)
    raise UnknownNameError("sky of a world", name, list(SKIES))


def _mixture(one: SkyModel, other: SkyModel) -> SkyModel:
    """Half of the one and half of the other."""
    nodes = one.frequency_mhz
    size = max(one.lmax, other.lmax) + 1
    spectra = np.concatenate([0.5 * sky.spectra(nodes) for sky in (one, other)], axis=1)
    parts = [np.pad(sky.multipoles, [(0, 0), *[(0, size - 1 - sky.lmax)] * 2]) for sky in (one, other)]
    multipoles = np.concatenate(parts)
    level = spectra @ multipoles[:, 0, 0].real / np.sqrt(4 * np.pi)
    return SkyModel(
        name=f"half {one.name}, half {other.name}",
        frequency_mhz=nodes,
        level=level,
        weight=spectra / level[:, None],
        multipoles=multipoles,
        has_cmb=one.has_cmb and other.has_cmb,
        has_isotropic=one.has_isotropic and other.has_isotropic,
        origin=f"mean of {one.origin} and {other.origin}",
    )


def tilt(sky: SkyModel, rng: np.random.Generator) -> SkyModel:
    """The sky with a random smooth spectral index over the sky beyond its own; unchanged at `PIVOT_MHZ`."""
    import healpy

    field = rng.normal(size=(INDEX_LMAX + 1, INDEX_LMAX + 1)) + 1j * rng.normal(size=(INDEX_LMAX + 1, INDEX_LMAX + 1))
    field[:, 0] = field[:, 0].real
    field[0] = 0.0
    nodes = sky.frequency_mhz
    dense = np.zeros((nodes.size, sky.lmax + 1, sky.lmax + 1), dtype=complex)
    with threadpool_limits(1):  # threads of healpy would wait for those of other trials: 13 s instead of 0.05 s
        index = _map_of(field)
        index *= INDEX_SPREAD / index.std()
        maps = np.array([_map_of(one) for one in sky.temperature(nodes)]) * (nodes[:, None] / PIVOT_MHZ) ** -index
        for row, values in enumerate(maps):
            dense[row].T[np.triu_indices(sky.lmax + 1)] = healpy.map2alm(values, lmax=sky.lmax, iter=1)
    level = dense[:, 0, 0].real / np.sqrt(4 * np.pi)
    return SkyModel(
        name=f"{sky.name}, tilted",
        frequency_mhz=nodes,
        level=level,
        weight=np.eye(nodes.size),
        multipoles=dense / level[:, None, None],
        has_cmb=True,
        has_isotropic=True,
        origin=f"{sky.origin}; spectral index changed at random",
    )


def _map_of(multipoles: Floats) -> Floats:
    """The map of multipoles of shape (l, m)."""
    import healpy

    lmax = len(multipoles) - 1
    return np.asarray(healpy.alm2map(multipoles.T[np.triu_indices(lmax + 1)].astype(complex), SIDE, lmax=lmax))


def _waves(lst_hours: Floats, rng: np.random.Generator) -> Floats:
    """A sum of harmonics of the sidereal day, shape (lst,)."""
    angle = 2 * np.pi / 24.0 * np.outer(np.arange(1, HARMONICS + 1), lst_hours)
    amplitude = rng.normal(size=(2, HARMONICS))
    values = amplitude[0] @ np.cos(angle) + amplitude[1] @ np.sin(angle)
    return np.asarray(LST_RMS * values / values.std())
