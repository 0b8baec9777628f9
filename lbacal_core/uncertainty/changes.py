"""What may be wrong with sky, pattern and ground: changes of P_sky, one standard deviation each."""

from __future__ import annotations

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.sky_terms import PAPER, SKY_BUDGETS, SkyTerm, sky_terms
from lbacal_core.skypower.variation import vary_sky_power

DEFAULT_SKY_BUDGET = "models"
PAPER_BUDGET = "paper"
PATTERN = "antenna pattern"
ZENITH_GAIN = 0.10
"""Change of the pattern's gain at zenith with its total fixed (section 4.2 of the paper)."""
GROUND = {30.0: 0.004, 55.0: 0.017, 80.0: 0.041}
"""Power from the ground over that of the sky by frequency, MHz: 75 K, a quarter of 300 K."""


def list_changes(instrument: Instrument, sky_budget: str = DEFAULT_SKY_BUDGET) -> list[SkyTerm]:
    """How far sky, pattern and ground may be from what C is made with; terms alike up to a bracket are one.

    Where no sky or antenna model reaches the instrument's channels, the level of the sky alone.
    """
    if sky_budget not in SKY_BUDGETS:
        raise BadInputError("sky budget", ", ".join(SKY_BUDGETS), repr(sky_budget))
    try:
        changes = [*sky_terms(instrument, sky_budget, instrument.sky or "gsm"), _pattern(instrument)]
        return changes if sky_budget == PAPER_BUDGET else [*changes, _ground(instrument)]
    except BadInputError:
        return [_level(instrument)]


def _level(instrument: Instrument) -> SkyTerm:
    """The error of the level that the paper gives."""
    hours = np.arange(24.0)
    size = np.full((hours.size, instrument.frequency_mhz.size), np.sqrt(sum(one**2 for one in PAPER.values())))
    change = dict.fromkeys(instrument.dipole_azimuth_deg, size)
    return SkyTerm("level of the sky", "Mulrey et al. 2019: no model reaches these channels", hours, change)


def _pattern(instrument: Instrument) -> SkyTerm:
    """The antenna pattern, wider or narrower."""
    own, wider = (vary_sky_power(instrument, zenith_gain_fraction=size) for size in (0.0, ZENITH_GAIN))
    change = {dipole: np.log(wider.power[dipole] / power) for dipole, power in own.power.items()}
    source = "gain at zenith +-10 % with the total fixed (Mulrey et al. 2019, section 4.2)"
    return SkyTerm(PATTERN, source, own.lst_hours, change)


def _ground(instrument: Instrument) -> SkyTerm:
    """Power that the antenna receives from the ground, the same at all LST."""
    own = compute_sky_power(instrument)
    share = np.interp(instrument.frequency_mhz, list(GROUND), list(GROUND.values()))
    change = {dipole: np.log1p(share * power.mean(axis=0) / power) for dipole, power in own.power.items()}
    return SkyTerm("ground and losses", "75 K of 300 K through the ground", own.lst_hours, change)
