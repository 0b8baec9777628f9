"""Where the Sun stands, to a hundredth of a degree."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.sidereal import local_sidereal_time

UNIX_J2000 = 946_728_000.0
"""Unix seconds of JD 2451545.0 (2000-01-01 12:00 UTC)."""


def sun_position(time_unix: Floats, latitude_deg: float, longitude_deg: float) -> tuple[Floats, Floats]:
    """Altitude and azimuth of the Sun.

    The low-precision formulae of the Astronomical Almanac (0.01 deg, 1950-2050), without refraction.

    Parameters
    ----------
    time_unix
        Shape (event,), s UTC.

    Returns
    -------
    Altitude and azimuth (north through east), each of shape (event,), rad.
    """
    days = (np.asarray(time_unix) - UNIX_J2000) / 86_400.0
    anomaly = np.radians(357.528 + 0.9856003 * days)
    mean_longitude = 280.460 + 0.9856474 * days
    longitude = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.radians(23.439 - 0.0000004 * days)
    right_ascension = np.arctan2(np.cos(obliquity) * np.sin(longitude), np.cos(longitude))
    declination = np.arcsin(np.sin(obliquity) * np.sin(longitude))
    hour_angle = np.radians(15.0 * local_sidereal_time(time_unix, longitude_deg)) - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(altitude), np.asarray(azimuth)
