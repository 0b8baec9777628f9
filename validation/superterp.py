"""The instrument of most proofs, the Superterp, and its sky power by any model; made once in each process."""

from __future__ import annotations

from functools import cache

from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower


@cache
def superterp() -> Instrument:
    return load_instrument("lofar-superterp")


@cache
def power_of(sky: str | None = None, antenna: str | None = None) -> SkyPower:
    """P_sky by a sky and an antenna; those that the instrument names unless given."""
    return compute_sky_power(superterp(), sky, antenna)
