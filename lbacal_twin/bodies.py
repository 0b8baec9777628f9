"""Where the twin's sky stands: the Sun, Jupiter and fixed directions, above the horizon of a place.

The formulas are those of the astronomical library ERFA, called here and not through the rooms that the finder uses.
"""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats

UNIX_EPOCH_JD = 2_440_587.5
EARTH, JUPITER = 3, 5
"""Numbers of the planets in `erfa.plan94`; the Earth with the Moon, 6 arcsec from the Earth alone."""


def sun_position(time_unix: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination of the Sun on the mean equator of date, rad; good to 0.01 degrees."""
    return _of_date(-_from_sun(EARTH, time_unix), time_unix)


def jupiter_position(time_unix: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination of Jupiter on the mean equator of date, rad; good to 0.05 degrees.

    Light takes 45 minutes on the way, in which Jupiter and Earth move by 0.01 degrees; this is left out.
    """
    return _of_date(_from_sun(JUPITER, time_unix) - _from_sun(EARTH, time_unix), time_unix)


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


def _from_sun(planet: int, time_unix: Floats) -> Floats:
    """Position of a planet from the Sun on the equator of J2000.0, au, shape (event, 3)."""
    return np.asarray(erfa.plan94(UNIX_EPOCH_JD, time_unix / 86_400.0, planet)["p"])


def _of_date(vector: Floats, time_unix: Floats) -> tuple[Floats, Floats]:
    """Right ascension and declination on the mean equator of each instant of vectors of J2000.0, shape (event, 3)."""
    precessed = erfa.c2s(erfa.rxp(erfa.pmat06(UNIX_EPOCH_JD, time_unix / 86_400.0), vector))
    return np.asarray(precessed[0]), np.asarray(precessed[1])
