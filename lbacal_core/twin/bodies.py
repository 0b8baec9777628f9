"""Where the Sun and Jupiter stand, from their mean orbits: enough for a beam as wide as the sky."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats

DAYS_OF_J2000 = 10_957.5
"""Days of 1970-01-01 to 2000-01-01 12:00 UTC."""
OBLIQUITY = np.radians(23.439)


def sun_position(time_unix: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination of the Sun, rad: the low-precision series of the Astronomical Almanac.

    Good to 0.01 degrees from 1950 to 2050.
    """
    days = time_unix / 86_400.0 - DAYS_OF_J2000
    mean_longitude = np.radians(280.460 + 0.985_647_4 * days)
    anomaly = np.radians(357.528 + 0.985_600_3 * days)
    longitude = mean_longitude + np.radians(1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    return _equatorial(longitude)


def jupiter_position(time_unix: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination of Jupiter, rad, from two orbits in one plane; good to about 2 degrees.

    Elements of J2000: Standish & Williams, approximate positions of the planets; inclination neglected.
    """
    days = time_unix / 86_400.0 - DAYS_OF_J2000
    anomaly = np.radians(19.67 + 0.083_129 * days)
    true = anomaly + 2 * 0.0484 * np.sin(anomaly)
    radius = 5.2026 * (1 - 0.0484 * np.cos(anomaly))
    heliocentric = true + np.radians(14.73)
    right_ascension, _ = sun_position(time_unix)
    sun_longitude = np.arctan2(np.sin(right_ascension), np.cos(right_ascension) * np.cos(OBLIQUITY))
    x = radius * np.cos(heliocentric) + np.cos(sun_longitude)
    y = radius * np.sin(heliocentric) + np.sin(sun_longitude)
    return _equatorial(np.arctan2(y, x))


def _equatorial(ecliptic_longitude: Floats) -> tuple[Floats, Floats]:
    sine = np.sin(ecliptic_longitude)
    right_ascension = np.arctan2(np.cos(OBLIQUITY) * sine, np.cos(ecliptic_longitude))
    return right_ascension, np.arcsin(np.sin(OBLIQUITY) * sine)


def on_the_equator_of(epoch: float, right_ascension: Floats, declination: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination on the mean equator of a Julian year from those of ICRS, rad, any shape."""
    matrix = erfa.pmat06(*erfa.epj2jd(epoch))
    of_date = erfa.c2s(erfa.rxp(matrix, erfa.s2c(right_ascension, declination)))
    return np.asarray(of_date[0]), np.asarray(of_date[1])


def horizontal(
    right_ascension: Floats, declination: Floats, lst_hours: Floats, latitude_deg: float
) -> tuple[Floats, Floats]:
    """Zenith angle and azimuth (north through east) of directions at sidereal times, rad; arguments broadcast."""
    hour_angle = np.asarray(lst_hours) * np.pi / 12 - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(np.pi / 2 - altitude), np.asarray(azimuth)
