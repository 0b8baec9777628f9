"""P_sky by the plain sum over the pixels of the visible sky, one LST after the other: the oracle of `sky.modes`."""

from __future__ import annotations

import numpy as np

from lbacal_core.antenna.model import AntennaModel, directional_response
from lbacal_core.grids import Floats
from lbacal_core.instrument.matching import power_per_kelvin_sr
from lbacal_core.sky.model import DATA_EPOCH, SkyModel, local_direction, precess


def sum_over_sky(
    temperature_k: Floats,
    right_ascension: Floats,
    declination: Floats,
    antenna: AntennaModel,
    arm_azimuth_deg: float,
    latitude_deg: float,
    lst_hours: Floats,
    frequency_mhz: Floats,
    pixel_sr: float,
) -> Floats:
    """P_sky of one dipole as eq. total_sky_power_eq reads.

    Parameters
    ----------
    temperature_k
        Shape (freq, pixel), K.
    right_ascension, declination
        Shape (pixel,), rad, equator of date.

    Returns
    -------
    Shape (lst, freq), W m^-2 MHz^-1.
    """
    power = np.empty((lst_hours.size, frequency_mhz.size))
    for row, lst in enumerate(lst_hours):
        zenith, azimuth = local_direction(lst, right_ascension, declination, latitude_deg)
        seen = zenith < np.pi / 2
        response = directional_response(
            antenna, frequency_mhz, zenith[seen], azimuth[seen] - np.radians(arm_azimuth_deg)
        )
        power[row] = np.einsum("fp,fp->f", temperature_k[:, seen], response) * pixel_sr
    return power * power_per_kelvin_sr(frequency_mhz)


def sum_over_pixels(
    sky: SkyModel,
    antenna: AntennaModel,
    arm_azimuth_deg: float,
    latitude_deg: float,
    lst_hours: Floats,
    frequency_mhz: Floats,
    nside: int = 64,
    epoch: float = DATA_EPOCH,
) -> Floats:
    """P_sky of one dipole from a HEALPix map of the sky model, shape (lst, freq), W m^-2 MHz^-1."""
    import healpy as hp

    multipoles = sky.temperature(frequency_mhz)
    # healpy packs a_lm by m, then l; the upper triangle of the transposed (l, m) array is exactly that order.
    packed = [values.T[np.triu_indices(sky.lmax + 1)] for values in multipoles]
    maps = np.array([hp.alm2map(values, nside, lmax=sky.lmax) for values in packed])
    colatitude, longitude = hp.pix2ang(nside, np.arange(hp.nside2npix(nside)))
    right_ascension, declination = precess(longitude, np.pi / 2 - colatitude, epoch)
    return sum_over_sky(
        maps,
        right_ascension,
        declination,
        antenna,
        arm_azimuth_deg,
        latitude_deg,
        lst_hours,
        frequency_mhz,
        hp.nside2pixarea(nside),
    )
