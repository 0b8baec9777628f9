from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import PrecessedGeocentric, SkyCoord, get_body, get_sun
from astropy.time import Time

from lbacal_core.grids import Floats
from lbacal_twin.bodies import horizontal, jupiter_position, on_the_equator_of, sun_position

TIMES = 1_388_534_400.0 + np.linspace(0, 7 * 365.25, 200) * 86_400


def _separation_deg(position: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> Floats:
    (a, d), (b, e) = position, other
    cosine = np.sin(d) * np.sin(e) + np.cos(d) * np.cos(e) * np.cos(a - b)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_the_sun_stands_where_astropy_has_it() -> None:
    sun = get_sun(Time(TIMES, format="unix")).transform_to("tete")
    separation = _separation_deg(sun_position(TIMES), (sun.ra.rad, sun.dec.rad))
    assert separation.max() < 0.02


def test_jupiter_stands_where_astropy_has_it() -> None:
    jupiter = get_body("jupiter", Time(TIMES, format="unix")).transform_to("tete")
    separation = _separation_deg(jupiter_position(TIMES), (jupiter.ra.rad, jupiter.dec.rad))
    assert separation.max() < 0.05  # aberration, nutation and the time of the light: 0.02 degrees


def test_a_star_of_2015_stands_where_astropy_has_it() -> None:
    star = SkyCoord(350.866, 58.812, unit="deg").transform_to(PrecessedGeocentric(equinox="J2015", obstime="J2015"))
    position = on_the_equator_of(2015.0, np.radians([350.866]), np.radians([58.812]))
    # 30 arcsec: the aberration that PrecessedGeocentric includes
    assert _separation_deg(position, (star.ra.rad, star.dec.rad)).max() < 30 / 3600


def test_a_source_on_the_meridian_has_its_zenith_angle_and_lies_south() -> None:
    zenith, azimuth = horizontal(np.radians(30.0), np.radians(10.0), np.array([2.0]), 52.9)
    assert np.degrees(zenith[0]) == pytest.approx(42.9)
    assert abs(np.degrees(azimuth[0])) == pytest.approx(180.0)
    _, later = horizontal(np.radians(30.0), np.radians(10.0), np.array([5.0]), 52.9)
    assert np.sin(later[0]) < 0  # it sets in the west
