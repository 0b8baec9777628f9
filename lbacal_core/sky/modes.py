"""P_sky as an exact Fourier series in LST, from the multipoles of sky and beam (m-modes).

With T in multipoles a_lm on the equator of date and D in multipoles beta_lm' on the local horizon (polar axis: the
zenith), the rotation from the one to the other is a turn about the pole by the LST and about the east by the
colatitude, so

    P(t) = sum_m exp(i m t) sum_l a_lm g_lm,   g_lm = sum_m' conj(beta_lm') d^l_{m'm}(-colatitude)

(m-mode formalism: Shaw et al. 2014, ApJ 781, 57). D has few azimuthal orders and needs no more multipoles than the
sky has, and the horizon is exact because beta_lm' comes from a Gauss-Legendre rule over the hemisphere.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy

from lbacal_core.antenna.model import AntennaModel, directional_response
from lbacal_core.antenna.varied import raise_arm
from lbacal_core.grids import Floats
from lbacal_core.instrument.matching import power_per_kelvin_sr
from lbacal_core.sky.model import DATA_EPOCH, Complexes, SkyModel, precess_multipoles, wigner_d, with_negative_orders

ZENITH_NODES = 64
AZIMUTHS = 32


def beam_multipoles(antenna: AntennaModel, frequency_mhz: Floats, lmax: int, tilt_deg: float = 0.0) -> Complexes:
    """b_lm' of D about the zenith, with the azimuth from the arm as longitude; shape (freq, l, m'), m' >= 0.

    D of an arm that is raised by a tilt is over the gain of the level antenna at zenith.
    """
    nodes, weights = np.polynomial.legendre.leggauss(ZENITH_NODES)
    cosine, weights = (nodes + 1) / 2, weights / 2
    zenith = np.arccos(cosine)
    azimuth = np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    raised = raise_arm(antenna, tilt_deg)
    response = directional_response(raised, frequency_mhz, zenith[:, None], azimuth[None, :], antenna)
    in_azimuth = np.fft.fft(response, axis=-1)[..., : AZIMUTHS // 2] * (2 * np.pi / AZIMUTHS)
    multipoles = np.zeros((frequency_mhz.size, lmax + 1, lmax + 1), dtype=complex)
    for m, legendre in enumerate(_legendre(lmax, tuple(zenith.tolist()))):
        multipoles[:, m:, m] = (in_azimuth[..., m] * weights) @ legendre.T
    return multipoles


@lru_cache(maxsize=8)
def _legendre(lmax: int, zenith: tuple[float, ...]) -> list[Floats]:
    """Spherical harmonics at azimuth 0, of each order that the azimuths resolve: shape (l, zenith), l >= order."""
    orders = range(min(lmax + 1, AZIMUTHS // 2))
    return [scipy.special.sph_harm_y(np.arange(m, lmax + 1)[:, None], m, np.array(zenith), 0.0).real for m in orders]


def beam_on_equator(beam: Complexes, arm_azimuth_deg: float, latitude_deg: float) -> Complexes:
    """g_lm: what multiplies the sky's a_lm in P(t) = sum_m exp(i m t) sum_l a_lm g_lm; shape (freq, l, m), m >= 0.

    Parameters
    ----------
    beam
        Shape (freq, l, m'), from `beam_multipoles`.
    """
    lmax = beam.shape[-1] - 1
    equator = np.zeros_like(beam)
    for order, matrix in enumerate(wigner_d(lmax, -np.radians(90.0 - latitude_deg))):
        m = np.arange(-order, order + 1)
        # The horizon frame is the equatorial one turned about the east by the colatitude: its x axis is south, its
        # longitude 180 deg - azimuth. In it D has the multipoles conj(beta_m) = (-1)^m b_m exp(-i m arm).
        local = with_negative_orders(beam, order) * (-1.0) ** m * np.exp(-1j * m * np.radians(arm_azimuth_deg))
        equator[:, order, : order + 1] = (local @ matrix)[:, order:]
    return equator


def sky_power_modes(
    sky: SkyModel, antenna: AntennaModel, arm_azimuth_deg: float, latitude_deg: float, frequency_mhz: Floats
) -> Complexes:
    """Fourier terms c_m of P_sky of one dipole, shape (m, freq), m >= 0, W m^-2 MHz^-1.

    P(t) = c_0 + 2 Re sum_{m>0} c_m exp(i m t), t the local mean sidereal time.
    """
    beam = beam_multipoles(antenna, frequency_mhz, sky.lmax)
    temperature = precess_multipoles(sky.temperature(frequency_mhz), DATA_EPOCH)
    return combine(temperature, beam, arm_azimuth_deg, latitude_deg, frequency_mhz)


def combine(
    temperature: Complexes, beam: Complexes, arm_azimuth_deg: float, latitude_deg: float, frequency_mhz: Floats
) -> Complexes:
    """Fourier terms of P_sky, (m, freq), from multipoles of sky and beam, (freq, l, m), on the equator of date."""
    seen = beam_on_equator(beam, arm_azimuth_deg, latitude_deg)
    return np.asarray(np.einsum("flm,flm->mf", temperature, seen) * power_per_kelvin_sr(frequency_mhz))


def sky_power_at(modes: Complexes, lst_hours: Floats) -> Floats:
    """P_sky at any LST from its Fourier terms, shape (lst, freq)."""
    order = np.arange(modes.shape[0])
    phase = np.exp(1j * np.pi / 12.0 * np.outer(lst_hours, order)) * np.where(order == 0, 1.0, 2.0)
    return np.asarray((phase @ modes).real)
