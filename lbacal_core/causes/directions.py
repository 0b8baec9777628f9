"""Changes of P_sky that need directions: own(with)/own(without), from the package's own sky and antenna."""

from __future__ import annotations

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument
from lbacal_core.sky.sources import SOURCES
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.sources import source_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.skypower.variation import vary_sky_power

SOURCE_KEYS = {"Cas A": "cas-a", "Cyg A": "cyg-a", "Tau A": "tau-a", "Vir A": "vir-a"}


def relative_sky_changes(instrument: Instrument) -> dict[str, SkyPower]:
    """exp(d ln P_sky per unit) of causes that need directions, by the name of the cause or of the source.

    Empty where the own models do not cover the instrument's channels.
    """
    try:
        own = compute_sky_power(instrument)
    except BadInputError:
        return {}

    def change(upper: SkyPower, lower: SkyPower, span: float) -> SkyPower:
        values = {d: np.exp(np.log(upper.power[d] / lower.power[d]) / span) for d in own.power}
        return SkyPower(own.frequency_mhz, own.lst_hours, values, "relative change")

    changes = {
        "dipole_azimuth": change(
            vary_sky_power(instrument, azimuth_deg=1.0), vary_sky_power(instrument, azimuth_deg=-1.0), 2.0
        ),
        "zenith_weighting": change(
            vary_sky_power(instrument, zenith_exponent=0.1), vary_sky_power(instrument, zenith_exponent=-0.1), 0.2
        ),
        "pattern_width": change(
            vary_sky_power(instrument, zenith_gain_fraction=0.05),
            vary_sky_power(instrument, zenith_gain_fraction=-0.05),
            0.1,
        ),
    }
    for name, key in SOURCE_KEYS.items():
        share = {d: source_sky_power(instrument, SOURCES[key], d, own.lst_hours) / own.power[d] for d in own.power}
        values = {d: np.exp(relative) for d, relative in share.items()}
        changes[name] = SkyPower(own.frequency_mhz, own.lst_hours, values, f"{name} through D")
    return changes
