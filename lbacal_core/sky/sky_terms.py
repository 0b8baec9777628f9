"""How far the sky may be from the model: independent changes of ln P_sky, for a budget of C.

Three budgets. ``paper``: scale, map and model of Mulrey et al. 2019. ``models``: the spread of seven sky models, and
what the shipped ones differ by beyond it. ``measured``: the error of the level on which experiments agree
(`validation.anchors`), and what carries it from their sky to the instrument's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import load_antenna
from lbacal_core.data.tables import read_content, read_prior
from lbacal_core.errors import require_name
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import power_per_kelvin_sr
from lbacal_core.linear import root_of
from lbacal_core.sky.antenna_of import antenna_of
from lbacal_core.sky.model import DATA_EPOCH, SkyModel, precess_multipoles
from lbacal_core.sky.modes import beam_multipoles, beam_on_equator, sky_power_at
from lbacal_core.sky.names import (
    BASE_SKY,
    MEASURED_SKY,
    PIVOT_MHZ,
    WIDE_SKIES,
    WIDE_SKY,
    default_sky,
    list_skies,
    load_sky,
    read_sky_level,
)
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower


def dipole_temperature(
    sky: SkyModel,
    antenna: AntennaModel,
    frequency_mhz: Floats,
    latitude_deg: float,
    lst_hours: Floats,
    arm: float = 0.0,
) -> Floats:
    """Brightness averaged over the response of a dipole with its arm at azimuth `arm`, deg, shape (lst, freq), K."""
    beam = beam_multipoles(antenna, frequency_mhz, sky.lmax)
    seen = beam_on_equator(beam, arm, latitude_deg)
    modes = np.einsum("flm,flm->mf", precess_multipoles(extended_temperature(sky, frequency_mhz), DATA_EPOCH), seen)
    return np.asarray(sky_power_at(modes, lst_hours) / (np.sqrt(4 * np.pi) * beam[:, 0, 0].real))


def mean_temperature(sky: SkyModel, antenna: AntennaModel, frequency_mhz: Floats, latitude_deg: float) -> Floats:
    """Average the temperature that a dipole records over the sidereal day, shape (freq,), K."""
    return np.asarray(dipole_temperature(sky, antenna, frequency_mhz, latitude_deg, np.arange(24.0)).mean(axis=0))


def extended_temperature(sky: SkyModel, frequency_mhz: Floats) -> Any:
    """Multipoles of the brightness, shape (freq, l, m), K.

    Above the range of the model a power law with the index at its end.
    """
    low, end = sky.frequency_mhz[-2:]
    inside = sky.temperature(np.minimum(frequency_mhz, end))
    first, last = sky.temperature(np.array([low, end]))[:, 0, 0].real
    index = np.log(last / first) / np.log(end / low)
    return inside * (np.maximum(frequency_mhz, end) / end)[:, None, None] ** index


EDGES_DEG = -26.715
EDGES_HEIGHT_M = 1.04
"""Where the sky was measured absolutely, and the height of the dipole that stands for the antenna there."""
OFFSET_MHZ, OFFSET_INDEX = 75.0, 2.55
EXTRAPOLATED_BELOW_MHZ = 50.0
EXTRAPOLATED_TO_MHZ = 30.0
"""The embedded sky is an extrapolation between the two."""
PAPER = {"sky_scale": "scale of the sky maps", "sky_fit": "fit of the maps", "sky_choice": "choice of the map"}
"""Rows of the prior, and the names of their terms."""


@dataclass(frozen=True)
class SkyTerm:
    """One standard deviation of ln P_sky, fully correlated along frequency and LST; terms are independent.

    Attributes
    ----------
    d_ln_p
        For each dipole, shape (lst, freq), on the LST of `lst_hours`.
    """

    name: str
    source: str
    lst_hours: Floats
    d_ln_p: Mapping[str, Floats]


def sky_terms(instrument: Instrument, budget: str = "measured", sky: str = MEASURED_SKY) -> tuple[SkyTerm, ...]:
    """The terms of a budget for an instrument's place, arms, antenna and channels.

    Parameters
    ----------
    budget
        One of `SKY_BUDGETS`.
    sky
        The sky model that C was made with. The budget ``measured`` is that of the sky `measured`; with `gsm` the
        measured difference between the two is a term of its own, in full.
    """
    require_name("sky budget", budget, SKY_BUDGETS)
    terms = SKY_BUDGETS[budget](instrument)
    if budget == "measured" and sky == BASE_SKY:
        own = compute_sky_power(instrument, BASE_SKY)
        bias = read_sky_level().ln_ratio(own.frequency_mhz)
        terms.append(_common(f"{BASE_SKY} is colder than measured", "lbacal_core/data/sky_level.json", own, bias))
    return tuple(terms)


def _paper_terms(instrument: Instrument) -> list[SkyTerm]:
    own = compute_sky_power(instrument, default_sky(instrument.frequency_mhz))
    return [
        _common(name, row.source, own, np.full_like(own.frequency_mhz, row.size))
        for row, name in ((read_prior()[key], name) for key, name in PAPER.items())
    ]


def _model_terms(instrument: Instrument) -> list[SkyTerm]:
    own = compute_sky_power(instrument, default_sky(instrument.frequency_mhz))
    row = read_prior()["sky_level"]
    level = _common("level of the sky", row.source, own, np.full_like(own.frequency_mhz, row.size))

    def without_mean(change: Mapping[str, Floats], _: str) -> dict[str, Floats]:
        mean = np.mean([values.mean() for values in change.values()])
        return {dipole: values - mean for dipole, values in change.items()}

    return [level, *_alternatives(instrument, own, "spectrum and LST shape", without_mean)]


def _measured_terms(instrument: Instrument) -> list[SkyTerm]:
    own = compute_sky_power(instrument, BASE_SKY)
    frequency_mhz, level = own.frequency_mhz, read_sky_level()
    root = root_of(level.covariance)
    source = "experiments of lbacal_core/data/sky_anchors.json, scatter between them included"
    x = np.log(frequency_mhz / PIVOT_MHZ)
    terms = [
        _common(name, source, own, root[0, k] + root[1, k] * x)
        for k, name in enumerate(("level of the sky", "slope of the sky"))
    ]
    per_e = read_prior()["sky_extrapolation"].size / np.log(EXTRAPOLATED_BELOW_MHZ / EXTRAPOLATED_TO_MHZ)
    below = per_e * np.log(np.maximum(EXTRAPOLATED_BELOW_MHZ / frequency_mhz, 1.0))
    if np.any(below):
        terms.append(_common("embedded sky below 50 MHz", "against the map at nside 64", own, below))
    terms.append(_zero_level_term(instrument, own))

    def tied(change: Mapping[str, Floats], name: str) -> dict[str, Floats]:
        """Less what the model differs by where the level was measured: transfer and LST shape are left."""
        there = np.log(_mean_at_edges(name, frequency_mhz) / _mean_at_edges(BASE_SKY, frequency_mhz))
        return {dipole: values - there for dipole, values in change.items()}

    return [*terms, *_alternatives(instrument, own, "transfer and LST shape", tied)]


def _common(name: str, source: str, own: SkyPower, size: Floats) -> SkyTerm:
    """The same at every LST and for both dipoles."""
    values = np.broadcast_to(size, (own.lst_hours.size, size.size))
    return SkyTerm(name, source, own.lst_hours, {dipole: np.array(values) for dipole in own.power})


def _alternatives(
    instrument: Instrument,
    own: SkyPower,
    what: str,
    change_of: Callable[[Mapping[str, Floats], str], dict[str, Floats]],
) -> list[SkyTerm]:
    """One term for each other sky that ships for these channels; their sum of squares is the mean square difference."""
    base = default_sky(instrument.frequency_mhz)
    names = [name for name in (WIDE_SKIES if base == WIDE_SKY else list_skies()) if name != base]
    terms = []
    for name in names:
        other = compute_sky_power(instrument, name)
        change = {dipole: np.log(other.power[dipole] / values) for dipole, values in own.power.items()}
        sizes = {dipole: values / np.sqrt(len(names)) for dipole, values in change_of(change, name).items()}
        source = f"sky {name} in place of {base}, one of {len(names)}"
        terms.append(SkyTerm(f"{what} ({name})", source, own.lst_hours, sizes))
    return terms


def zero_level_sigma_k() -> float:
    """Root mean square of the offsets that map corrections give, carried to 75 MHz with nu^-2.55, K."""
    offsets = [
        one["offset_k"] * (np.mean(one["frequency_mhz"]) / OFFSET_MHZ) ** OFFSET_INDEX
        for one in read_content("sky_anchors")
        if one["kind"] == "map"
    ]
    return float(np.sqrt(np.mean(np.square(offsets))))


def _zero_level_term(instrument: Instrument, own: SkyPower) -> SkyTerm:
    """A uniform brightness, with the scale such that the mean where the level was measured stays."""
    frequency_mhz = own.frequency_mhz
    kelvin = zero_level_sigma_k() * (frequency_mhz / OFFSET_MHZ) ** -OFFSET_INDEX
    beam = beam_multipoles(load_antenna(antenna_of(instrument)), frequency_mhz, 0)
    solid_angle = beam[:, 0, 0].real * np.sqrt(4 * np.pi)
    uniform = kelvin * solid_angle * power_per_kelvin_sr(frequency_mhz)
    there = kelvin / _mean_at_edges(BASE_SKY, frequency_mhz)
    change = {dipole: uniform / values - there for dipole, values in own.power.items()}
    source = f"offsets of the maps corrected so far, {kelvin[0]:.0f} K at {frequency_mhz[0]:g} MHz"
    return SkyTerm("zero level of the sky", source, own.lst_hours, change)


def _mean_at_edges(sky: str, frequency_mhz: Floats) -> Floats:
    return mean_temperature(load_sky(sky), ShortDipole(EDGES_HEIGHT_M), frequency_mhz, EDGES_DEG)


SKY_BUDGETS: dict[str, Callable[[Instrument], list[SkyTerm]]] = {
    "paper": _paper_terms,
    "models": _model_terms,
    "measured": _measured_terms,
}
"""What the error of the sky can be taken from, by name."""
