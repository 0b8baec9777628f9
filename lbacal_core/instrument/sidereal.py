"""Local sidereal time from UTC."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import DAY_S, JULIAN_DATE_OF_1970, Floats

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
    days = np.asarray(time_unix, dtype=float) / DAY_S
    greenwich = erfa.gmst06(JULIAN_DATE_OF_1970, days, JULIAN_DATE_OF_1970, days)
    return np.asarray((greenwich * (12.0 / np.pi) + longitude_deg / 15.0) % 24.0, dtype=float)


# Where the Sun stands, to a hundredth of a degree.

EARTH = 3
"""The number under which `erfa.plan94` has the centre of mass of Earth and Moon."""


def sun_position(time_unix: Floats, latitude_deg: float, longitude_deg: float) -> tuple[Floats, Floats]:
    """Altitude and azimuth of the Sun.

    From the orbit of the Earth and the Moon (`erfa.plan94`, 3 arcsec; the Earth itself by `erfa.epv00` takes 150 times
    as long) on the mean equator of date (`erfa.pmat06`), without the Earth's way around that centre (6 arcsec),
    aberration (20 arcsec), nutation (17 arcsec), parallax (9 arcsec) and refraction.

    Parameters
    ----------
    time_unix
        Shape (event,), s UTC.

    Returns
    -------
    Altitude and azimuth (north through east), each of shape (event,), rad.
    """
    days = np.asarray(time_unix) / DAY_S
    earth_from_sun = erfa.plan94(JULIAN_DATE_OF_1970, days, EARTH)["p"]
    towards_sun = erfa.rxp(erfa.pmat06(JULIAN_DATE_OF_1970, days), -earth_from_sun)
    right_ascension, declination = erfa.c2s(towards_sun)
    hour_angle = np.radians(15.0 * local_sidereal_time(time_unix, longitude_deg)) - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(altitude), np.asarray(azimuth)
