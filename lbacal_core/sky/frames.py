"""Directions: from ICRS to the equator of date, and from there to the local sky."""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats

DATA_EPOCH = 2015.0
"""Julian year of the equator that P_sky(LST) refers to; see docs/decisions/precession.md."""


def precession_angles(epoch: float) -> tuple[float, float, float]:
    """Equatorial precession angles zeta_A, z_A, theta_A from J2000.0 to the mean equator of `epoch`, rad.

    IAU 2006 (Capitaine, Wallace & Chapront 2003, A&A 412, 567, eq. 40), to third order in time; the frame bias
    between ICRS and J2000.0 (0.02 arcsec) is left out.
    """
    t = (epoch - 2000.0) / 100.0
    zeta = 2.650545 + t * (2306.083227 + t * (0.2988499 + t * 0.01801828))
    z = -2.650545 + t * (2306.077181 + t * (1.0927348 + t * 0.01826837))
    theta = t * (2004.191903 + t * (-0.4294934 - t * 0.04182264))
    return tuple(np.radians(np.array([zeta, z, theta]) / 3600.0).tolist())


def precess(right_ascension: Floats, declination: Floats, epoch: float) -> tuple[Floats, Floats]:
    """Right ascension and declination of date from those of J2000.0, rad, any shape."""
    zeta, z, theta = precession_angles(epoch)
    angle = np.asarray(right_ascension) + zeta
    a = np.cos(declination) * np.sin(angle)
    b = np.cos(theta) * np.cos(declination) * np.cos(angle) - np.sin(theta) * np.sin(declination)
    c = np.sin(theta) * np.cos(declination) * np.cos(angle) + np.cos(theta) * np.sin(declination)
    return np.arctan2(a, b) + z, np.arcsin(np.clip(c, -1.0, 1.0))


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
    latitude = np.radians(latitude_deg)
    east = -np.cos(declination) * np.sin(hour_angle)
    north = np.cos(latitude) * np.sin(declination) - np.sin(latitude) * np.cos(declination) * np.cos(hour_angle)
    up = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour_angle)
    return np.arccos(np.clip(up, -1.0, 1.0)), np.arctan2(east, north) % (2 * np.pi)
