"""The antenna model that belongs to an instrument."""

from __future__ import annotations

import numpy as np

from lbacal_core.antenna.names import ANTENNAS, DEFAULT_ANTENNA
from lbacal_core.data.lofar import LOFAR_DEG, LOFAR_RADIUS_DEG
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument


def antenna_for_ratios(instrument: Instrument) -> str:
    """The antenna model that an instrument names, else the default one.

    For changes of the beam or the sky by ratio, P own(with) / own(without), beside a sky power that was given: there
    the pattern of another antenna is off by the difference of the ratios only.
    """
    return instrument.antenna or DEFAULT_ANTENNA


def antenna_of(instrument: Instrument) -> str:
    """The antenna model that an instrument names; for one among LOFAR's Dutch stations that of LOFAR.

    Raises
    ------
    BadInputError
        Where an instrument elsewhere names none. The pattern of another antenna would put C wrong by 24-51 %.
    """
    if instrument.antenna is not None:
        return instrument.antenna
    north = instrument.latitude_deg - LOFAR_DEG[0]
    east = (instrument.longitude_deg - LOFAR_DEG[1]) * np.cos(np.radians(LOFAR_DEG[0]))
    if np.hypot(north, east) <= LOFAR_RADIUS_DEG:
        return DEFAULT_ANTENNA
    raise BadInputError(
        f"instrument {instrument.name}: antenna",
        f"the name of an antenna model ({', '.join(sorted(ANTENNAS))}) or a file of Jones terms, in the instrument "
        "file or as lbacal sky-power --antenna, whose file fit, budget and investigate take (--sky-power)",
        "none, and the instrument does not stand among LOFAR's stations, whose antenna is the default",
    )
