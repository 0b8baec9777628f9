from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.ideal import IsotropicAntenna, QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.model import AntennaModel, directional_response
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.sky.model import SkyModel, local_direction, precess
from lbacal_core.sky.names import load_sky
from lbacal_core.skypower.direct import sum_over_pixels
from lbacal_core.skypower.modes import beam_multipoles, sky_power_at, sky_power_modes
from lbacal_core.skypower.power import power_per_kelvin_sr

LATITUDE = 52.91512
FREQUENCY_MHZ = np.array([30.0, 55.0, 80.0])
LST = np.arange(0, 24, 2.7)


def sky_of(multipoles: np.ndarray) -> SkyModel:
    """A flat spectrum, nothing to be added."""
    nodes = np.array([20.0, 50.0, 100.0])
    return SkyModel("test", nodes, np.ones(3), np.ones((3, 1)), multipoles[None], True, True, "test")


def uniform_sky(temperature_k: float) -> SkyModel:
    multipoles = np.zeros((3, 3), dtype=complex)
    multipoles[0, 0] = temperature_k * np.sqrt(4 * np.pi)
    return sky_of(multipoles)


def solid_angle(antenna: AntennaModel) -> np.ndarray:
    modes = sky_power_modes(uniform_sky(1.0), antenna, 45.0, LATITUDE, FREQUENCY_MHZ)
    return sky_power_at(modes, LST) / power_per_kelvin_sr(FREQUENCY_MHZ)


def test_a_uniform_sky_seen_isotropically_is_two_pi_steradian() -> None:
    assert solid_angle(IsotropicAntenna()) == pytest.approx(2 * np.pi, rel=1e-12)


def test_the_plain_sum_of_a_uniform_sky_seen_isotropically_is_two_pi_steradian() -> None:
    power = sum_over_pixels(uniform_sky(1.0), IsotropicAntenna(), 45.0, LATITUDE, LST, FREQUENCY_MHZ)
    # 1e-3: a pixel of nside 64 counts wholly or not at all at the horizon.
    assert power / power_per_kelvin_sr(FREQUENCY_MHZ) == pytest.approx(2 * np.pi, rel=1e-3)


def test_a_short_dipole_over_a_perfect_plane_has_its_closed_form() -> None:
    dipole = ShortDipole(height_m=1.5)
    expected = np.broadcast_to(dipole.solid_angle(FREQUENCY_MHZ), (LST.size, 3))
    assert solid_angle(dipole) == pytest.approx(expected, rel=1e-12)


def test_a_short_dipole_close_to_the_plane_has_8_pi_over_15() -> None:
    # s -> cos(theta): the integral of (cos^2 cos^2(phi) + sin^2(phi)) cos^2 is pi (1/3 + 1/5).
    assert ShortDipole(height_m=1e-3).solid_angle(FREQUENCY_MHZ) == pytest.approx(np.pi * 8 / 15, rel=1e-4)


@pytest.mark.parametrize("arm", [45.0, 135.0, 20.0])
def test_the_fourier_series_agrees_with_the_plain_sum(arm: float) -> None:
    sky, antenna = load_sky("gsm"), load_hamaker()
    series = sky_power_at(sky_power_modes(sky, antenna, arm, LATITUDE, FREQUENCY_MHZ), LST)
    plain = sum_over_pixels(sky, antenna, arm, LATITUDE, LST, FREQUENCY_MHZ)
    assert series == pytest.approx(plain, rel=1e-4)


@pytest.mark.parametrize("latitude", [-35.2, 0.0, 78.9])
def test_the_fourier_series_agrees_with_the_plain_sum_from_other_sites(latitude: float) -> None:
    sky, antenna = load_sky("gsm"), load_hamaker()
    series = sky_power_at(sky_power_modes(sky, antenna, 0.0, latitude, FREQUENCY_MHZ), LST[:3])
    plain = sum_over_pixels(sky, antenna, 0.0, latitude, LST[:3], FREQUENCY_MHZ)
    assert series == pytest.approx(plain, rel=1e-4)


def test_a_tilted_antenna_agrees_with_the_plain_sum() -> None:
    # The tilt breaks every symmetry of the pattern: odd azimuthal orders, and a cut at the horizon.
    sky, antenna = load_sky("gsm"), VariedAntenna(load_hamaker(), tilt_deg=6.0, tilt_towards_deg=30.0)
    series = sky_power_at(sky_power_modes(sky, antenna, 45.0, LATITUDE, FREQUENCY_MHZ), LST)
    plain = sum_over_pixels(sky, antenna, 45.0, LATITUDE, LST, FREQUENCY_MHZ)
    assert series == pytest.approx(plain, rel=3e-4)  # the step at the horizon falls between pixels


def point_source(right_ascension: float, declination: float, lmax: int) -> SkyModel:
    """Multipoles of a unit point (T dOmega = 1 K sr) at a place of the equator of J2000."""
    from scipy.special import sph_harm_y

    order, m = np.mgrid[: lmax + 1, : lmax + 1]
    values = sph_harm_y(order, np.minimum(m, order), np.pi / 2 - declination, right_ascension).conj()
    return sky_of(np.tril(np.ones_like(values)) * values)


@pytest.mark.parametrize("source", [(350.866, 58.812), (299.868, 40.734), (83.633, 22.014)])
def test_a_point_source_is_seen_with_the_response_of_its_direction(source: tuple[float, float]) -> None:
    ra, dec = np.radians(source)
    lmax = 90
    # A dipole just above the plane: a smooth response, of which l <= 90 keeps all but 1e-3 of its maximum.
    antenna = ShortDipole(height_m=0.1)
    modes = sky_power_modes(point_source(ra, dec, lmax), antenna, 45.0, LATITUDE, FREQUENCY_MHZ)
    seen = sky_power_at(modes, LST) / power_per_kelvin_sr(FREQUENCY_MHZ)
    zenith, azimuth = local_direction(LST, *precess(ra, dec, 2015.0), LATITUDE)
    expected = directional_response(antenna, FREQUENCY_MHZ, zenith, azimuth - np.radians(45.0)).T
    assert seen == pytest.approx(expected, abs=1e-3)


def test_turning_the_arm_by_180_degrees_changes_nothing() -> None:
    sky = load_sky("gsm")
    one, other = (sky_power_modes(sky, load_hamaker(), arm, LATITUDE, FREQUENCY_MHZ) for arm in (45.0, 225.0))
    assert one == pytest.approx(other, rel=1e-12)


def test_few_fourier_terms_carry_the_whole_variation() -> None:
    modes = sky_power_modes(load_sky("gsm"), load_hamaker(), 45.0, LATITUDE, FREQUENCY_MHZ)
    lst = np.arange(240) / 10
    assert sky_power_at(modes[:9], lst) == pytest.approx(sky_power_at(modes, lst), rel=1e-4)


def test_the_beam_has_no_multipole_beyond_its_azimuthal_orders() -> None:
    beam = beam_multipoles(load_hamaker(), FREQUENCY_MHZ, 12)
    assert np.abs(beam[..., 7:]).max() < 1e-12
    assert np.abs(beam[..., 1::2]).max() < 1e-12


def test_a_quarter_wave_dipole_is_a_short_one_at_that_height_at_every_frequency():
    zenith, azimuth = np.radians([[10.0, 60.0]]), np.radians([[20.0, 200.0]])
    for nu in (30.0, 350.0):
        short = ShortDipole(speed_of_light / (4e6 * nu))
        for one, other in zip(
            QuarterWaveDipole().jones(np.array([nu]), zenith, azimuth),
            short.jones(np.array([nu]), zenith, azimuth),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-12)
