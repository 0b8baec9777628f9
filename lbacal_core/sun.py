"""Where the Sun stands, to a hundredth of a degree."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.sidereal import JULIAN_DATE_OF_1970, local_sidereal_time

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
    days = np.asarray(time_unix) / 86_400.0
    earth_from_sun = erfa.plan94(JULIAN_DATE_OF_1970, days, EARTH)["p"]
    towards_sun = erfa.rxp(erfa.pmat06(JULIAN_DATE_OF_1970, days), -earth_from_sun)
    right_ascension, declination = erfa.c2s(towards_sun)
    hour_angle = np.radians(15.0 * local_sidereal_time(time_unix, longitude_deg)) - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(altitude), np.asarray(azimuth)
