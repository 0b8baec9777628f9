"""Local sidereal time from UTC."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats

JULIAN_DATE_OF_1970 = 2_440_587.5
"""Julian date at which Unix time begins (1970-01-01 00:00 UTC)."""

SIDEREAL_DAY_S = 86_164.0905
"""Mean sidereal day, s."""


def local_sidereal_time(time_unix: Floats, longitude_deg: float) -> Floats:
    """Local mean sidereal time of instants.

    Greenwich mean sidereal time of IAU 2006 (`erfa.gmst06`; Capitaine, Wallace & Chapront 2003, A&A 412, 567, eq. 42)
    with UTC for both of its clocks: UT1 (|difference| < 0.9 s) and TT, which precession alone sees (69 s: 7 us).
    Without nutation (< 1.2 s) the result is within 2 s of the apparent sidereal time, a tenth of the smallest LST
    offset that one station-year can show.

    Parameters
    ----------
    time_unix
        Shape (...), s UTC.
    longitude_deg
        Geodetic longitude, degrees, east positive.

    Returns
    -------
    Shape (...), hours in [0, 24).
    """
    days = np.asarray(time_unix, dtype=float) / 86_400.0
    greenwich = erfa.gmst06(JULIAN_DATE_OF_1970, days, JULIAN_DATE_OF_1970, days)
    return np.asarray((greenwich * (12.0 / np.pi) + longitude_deg / 15.0) % 24.0, dtype=float)
