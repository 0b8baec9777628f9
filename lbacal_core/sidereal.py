"""Local sidereal time from UTC."""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats

UNIX_J2000 = 946_728_000.0
"""Unix seconds of JD 2451545.0 (2000-01-01 12:00 UTC)."""

SIDEREAL_DAY_S = 86_164.0905
"""Mean sidereal day, s."""


def local_sidereal_time(time_unix: Floats, longitude_deg: float) -> Floats:
    """Local mean sidereal time of instants.

    Earth rotation angle and the accumulated precession of IAU 2006 (Capitaine, Wallace & Chapront 2003,
    A&A 412, 567, eq. 42), with UT1 = UTC (|difference| < 0.9 s) and without nutation (< 1.2 s): within 2 s
    of the apparent sidereal time, a tenth of the smallest LST offset that one station-year can show.

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
    days = (np.asarray(time_unix, dtype=float) - UNIX_J2000) / 86_400.0
    rotation = 0.779_057_273_264_0 + 0.002_737_811_911_354_48 * days + days % 1.0
    centuries = days / 36_525.0
    precession_arcsec = 0.014_506 + (4_612.156_534 + 1.391_581_7 * centuries) * centuries
    hours = 24.0 * rotation + precession_arcsec / 54_000.0 + longitude_deg / 15.0
    return np.asarray(hours % 24.0, dtype=float)
