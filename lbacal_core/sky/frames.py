"""Directions: from ICRS to the equator of date, and from there to the local sky."""

from __future__ import annotations

import erfa
import numpy as np

from lbacal_core.grids import Floats

DATA_EPOCH = 2015.0
"""Julian year of the equator that P_sky(LST) refers to; see docs/decisions/precession.md."""


def precession_angles(epoch: float) -> tuple[float, float, float]:
    """Equatorial precession angles zeta_A, z_A, theta_A from J2000.0 to the mean equator of `epoch`, rad.

    IAU 2006 (`erfa.p06e`; Capitaine, Wallace & Chapront 2003, A&A 412, 567, eq. 40); the frame bias between ICRS and
    J2000.0 (0.02 arcsec) is left out.
    """
    z, zeta, theta = erfa.p06e(*erfa.epj2jd(epoch))[9:12]
    return float(zeta), float(z), float(theta)


def precess(right_ascension: Floats, declination: Floats, epoch: float) -> tuple[Floats, Floats]:
    """Right ascension and declination of date from those of J2000.0, rad, any shape."""
    zeta, z, theta = precession_angles(epoch)
    to_date = erfa.rz(-z, erfa.ry(theta, erfa.rz(-zeta, np.eye(3))))
    of_date = erfa.c2s(erfa.rxp(to_date, erfa.s2c(right_ascension, declination)))
    return np.asarray(of_date[0]), np.asarray(of_date[1])


def local_direction(
    lst_hours: Floats, right_ascension: Floats, declination: Floats, latitude_deg: float
) -> tuple[Floats, Floats]:
    """Zenith angle and azimuth (north through east) of directions given for the equator of date.

    Parameters
    ----------
    lst_hours, right_ascension, declination
        Local sidereal time in hours and direction in rad; shapes that broadcast.
    latitude_deg
        Geodetic latitude, degrees.

    Returns
    -------
    Zenith angle and azimuth in [0, 2 pi), rad, of the broadcast shape.
    """
    hour_angle = np.asarray(lst_hours) * (np.pi / 12.0) - right_ascension
    azimuth, altitude = erfa.hd2ae(hour_angle, declination, np.radians(latitude_deg))
    return np.asarray(np.pi / 2 - altitude), np.asarray(azimuth)
