import astropy.units as u
import erfa
import healpy
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time
from scipy.special import sph_harm_y
from threadpoolctl import threadpool_limits

from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.model import Complexes, local_direction, precess, precess_multipoles, precession_angles, wigner_d

LATITUDE, LONGITUDE = 52.91512, 6.86983
CAS_A = (350.866, 58.812)
CYG_A = (299.868, 40.734)
ARCMIN = np.radians(1 / 60)


def direction_at(unix: float, source: tuple[float, float], longitude: float = LONGITUDE) -> tuple[float, float]:
    lst = local_sidereal_time(np.array([unix]), longitude)
    epoch = 2000.0 + (unix - 946_728_000.0) / (365.25 * 86400)
    zenith, azimuth = local_direction(lst, *precess(*np.radians(source), epoch), LATITUDE)
    return float(zenith[0]), float(azimuth[0])


@pytest.mark.parametrize("source", [CAS_A, CYG_A, (83.633, 22.014), (187.706, 12.391)])
@pytest.mark.parametrize("instant", ["2012-02-03T04:05:06", "2016-08-21T18:00:00"])
def test_directions_agree_with_astropy(source, instant):
    place = EarthLocation.from_geodetic(LONGITUDE * u.deg, LATITUDE * u.deg, 49 * u.m)
    when = Time(instant, scale="utc")
    seen = SkyCoord(*source, unit="deg").transform_to(AltAz(obstime=when, location=place))
    zenith, azimuth = direction_at(when.unix, source)
    # One arcminute: aberration (20 arcsec), nutation (17 arcsec) and UT1 - UTC (up to 0.9 s = 14 arcsec) together.
    assert zenith == pytest.approx(seen.zen.rad, abs=ARCMIN)
    assert (azimuth - seen.az.rad) * np.sin(zenith) == pytest.approx(0, abs=ARCMIN)


def test_precession_is_the_polynomials_of_the_paper_and_the_spherical_triangle():
    # Capitaine, Wallace & Chapront 2003, eq. 40, to third order, by hand
    t = 0.15
    zeta, z, theta = np.radians(
        np.array(
            [
                2.650545 + t * (2306.083227 + t * (0.2988499 + t * 0.01801828)),
                -2.650545 + t * (2306.077181 + t * (1.0927348 + t * 0.01826837)),
                t * (2004.191903 + t * (-0.4294934 - t * 0.04182264)),
            ]
        )
        / 3600.0
    )
    assert precession_angles(2015.0) == pytest.approx((zeta, z, theta), abs=1e-12)  # the fourth order: 1e-13
    ra, dec = np.radians([10.0, 200.0, 300.0]), np.radians([80.0, -20.0, 45.0])
    a = np.cos(dec) * np.sin(ra + zeta)
    b = np.cos(theta) * np.cos(dec) * np.cos(ra + zeta) - np.sin(theta) * np.sin(dec)
    c = np.sin(theta) * np.cos(dec) * np.cos(ra + zeta) + np.cos(theta) * np.sin(dec)
    moved_ra, moved_dec = precess(ra, dec, 2015.0)
    assert np.exp(1j * moved_ra) == pytest.approx(np.exp(1j * (np.arctan2(a, b) + z)), abs=1e-11)
    assert moved_dec == pytest.approx(np.arcsin(c), abs=1e-11)


def test_a_local_direction_is_the_spherical_triangle():
    rng = np.random.default_rng(8)
    lst, ra, dec = rng.uniform(0, 24, 200), rng.uniform(0, 2 * np.pi, 200), np.arcsin(rng.uniform(-1, 1, 200))
    angle, latitude = lst * np.pi / 12 - ra, np.radians(LATITUDE)
    east = -np.cos(dec) * np.sin(angle)
    north = np.cos(latitude) * np.sin(dec) - np.sin(latitude) * np.cos(dec) * np.cos(angle)
    up = np.sin(latitude) * np.sin(dec) + np.cos(latitude) * np.cos(dec) * np.cos(angle)
    zenith, azimuth = local_direction(lst, ra, dec, LATITUDE)
    assert np.cos(zenith) == pytest.approx(up, abs=1e-13)
    assert np.sin(zenith) * np.exp(1j * azimuth) == pytest.approx(north + 1j * east, abs=1e-13)
    assert azimuth.min() >= 0.0


def test_precession_agrees_with_the_matrix_of_erfa():
    matrix = erfa.pmat06(2_400_000.5, erfa.epj2jd(2018.0)[1])
    ra, dec = np.radians([10.0, 200.0, 300.0]), np.radians([80.0, -20.0, 45.0])
    vector = matrix @ np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    moved_ra, moved_dec = precess(ra, dec, 2018.0)
    # 0.03 arcsec: the frame bias, which ours leaves out.
    assert np.angle(np.exp(1j * (moved_ra - np.arctan2(vector[1], vector[0])))) == pytest.approx(0, abs=1e-6)
    assert moved_dec == pytest.approx(np.arcsin(vector[2]), abs=2e-7)


def test_a_source_is_in_the_east_before_it_is_on_the_meridian_when_lst_equals_its_right_ascension():
    zenith, azimuth = local_direction(np.array([5.0, 8.0, 11.0]), np.radians(120.0), np.radians(20.0), LATITUDE)
    assert np.degrees([zenith[1], azimuth[1]]) == pytest.approx([LATITUDE - 20.0, 180.0])
    assert 0 < azimuth[0] < np.pi
    assert np.pi < azimuth[2] < 2 * np.pi


def test_cassiopeia_a_never_sets_at_the_superterp():
    zenith, _ = local_direction(np.arange(0, 24, 0.1), *precess(*np.radians(CAS_A), 2015.0), LATITUDE)
    assert np.degrees(zenith.max()) == pytest.approx(180.0 - LATITUDE - 58.9, abs=0.2)
    assert zenith.max() < np.pi / 2


def test_one_degree_further_east_a_source_transits_four_minutes_earlier():
    unix = Time("2014-05-01T12:00:00", scale="utc").unix
    sidereal = 240 * 0.99726957
    earlier = direction_at(unix - sidereal, CYG_A, LONGITUDE + 1)
    assert earlier == pytest.approx(direction_at(unix, CYG_A), abs=1e-5)


def field(multipoles: Complexes, longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    lmax = multipoles.shape[-1] - 1
    total = np.zeros(longitude.shape)
    for order in range(lmax + 1):
        for m in range(order + 1):
            value = multipoles[order, m] * sph_harm_y(order, m, np.pi / 2 - latitude, longitude)
            total += (1 if m == 0 else 2) * value.real
    return total


def random_multipoles(lmax: int) -> Complexes:
    rng = np.random.default_rng(3)
    values = np.tril(rng.normal(size=(lmax + 1, lmax + 1)) + 1j * rng.normal(size=(lmax + 1, lmax + 1)))
    values[:, 0] = values[:, 0].real
    return values


def test_wigner_d_of_one_is_the_textbook_matrix():
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    # Edmonds 1957, table 2, rows m' and columns m from -1 to 1.
    expected = [
        [(1 + c) / 2, s / np.sqrt(2), (1 - c) / 2],
        [-s / np.sqrt(2), c, s / np.sqrt(2)],
        [(1 - c) / 2, -s / np.sqrt(2), (1 + c) / 2],
    ]
    assert wigner_d(1, angle)[1] == pytest.approx(np.array(expected), abs=1e-14)


def test_wigner_d_is_orthogonal_at_high_order():
    matrix = wigner_d(64, 1.1)[64]
    assert matrix @ matrix.T == pytest.approx(np.eye(129), abs=1e-12)


def test_a_precessed_field_has_at_the_precessed_place_the_value_it_had():
    multipoles = random_multipoles(8)
    rng = np.random.default_rng(4)
    ra, dec = rng.uniform(0, 2 * np.pi, 30), np.arcsin(rng.uniform(-1, 1, 30))
    later = precess_multipoles(multipoles, 2150.0)  # far, so that a wrong sign shows
    assert field(later, *precess(ra, dec, 2150.0)) == pytest.approx(field(multipoles, ra, dec), abs=1e-12)


def test_precession_of_multipoles_is_the_rotation_of_healpy():
    multipoles = random_multipoles(24)
    upper = np.triu_indices(25)  # healpy packs by m, then l: the transposed upper triangle
    packed = np.ascontiguousarray(multipoles.T[upper])
    zeta, z, theta = precession_angles(2150.0)
    with threadpool_limits(1):  # its threads wait for each other where the processor is busy
        healpy.rotate_alm(packed, zeta, -theta, z)
    assert precess_multipoles(multipoles, 2150.0).T[upper] == pytest.approx(packed, abs=1e-12)
