from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import PrecessedGeocentric, SkyCoord, get_body, get_sun
from astropy.time import Time

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.bodies import horizontal, jupiter_position, on_the_equator_of, sun_position
from lbacal_twin.gains import NOISES
from lbacal_twin.view import View
from lbacal_twin.world import ANTENNAS, LST_RMS, OUTSIDE, SKIES, World, draw_world, make_sky, tilt

AT = np.array([30.0, 55.0, 80.0])


def test_half_of_two_skies_is_their_mean() -> None:
    half, lfsm, gsm = (make_sky(name).temperature(AT) for name in ("half", "lfsm", "gsm408"))
    # Half of the CMB of the one is counted with the other: 1.4 K of thousands.
    np.testing.assert_allclose(half, (lfsm + gsm) / 2, atol=10.0)


def test_the_sky_of_edges_is_warmer_by_what_was_measured() -> None:
    ratio = make_sky("edges").temperature(AT)[:, 0, 0].real / load_sky("gsm").temperature(AT)[:, 0, 0].real
    assert 1.09 < ratio[1] < 1.18  # 1.14 of gsm between 50 and 60 MHz; gsm408 is 2 % off gsm


def test_every_sky_differs_from_every_other() -> None:
    means = np.array([make_sky(name).temperature(AT)[:, 0, 0].real for name in SKIES])
    for row, name in enumerate(SKIES):
        others = np.delete(means, row, axis=0)
        assert np.all(np.abs(others / means[row] - 1).max(axis=1) > 0.003), name


def test_a_tilted_sky_is_itself_at_the_pivot_and_another_elsewhere() -> None:
    sky = load_sky("gsm408")
    tilted = tilt(sky, np.random.default_rng(1))
    pivot = np.array([55.0])
    np.testing.assert_allclose(tilted.temperature(pivot)[0], sky.temperature(pivot)[0], atol=5.0)  # K of 5000
    change = np.abs(tilted.temperature(AT) - sky.temperature(AT))[[0, 2]].max(axis=(1, 2))
    assert np.all(change > 0.005 * sky.temperature(AT)[[0, 2], 0, 0].real)


@pytest.mark.parametrize("outside", OUTSIDE)
def test_a_sky_outside_every_model_differs_in_the_way_it_says(low_band: Instrument, outside: str) -> None:
    plain = World("gsm408", "inverted-v", "behind").sky_power(low_band)
    drawn = World("gsm408", "inverted-v", "behind", outside, 4).sky_power(low_band)
    ratio = np.log(drawn.power["X"] / plain.power["X"])
    level, shape = ratio.mean(axis=0), ratio - ratio.mean(axis=0)
    if outside == "level":
        assert np.ptp(ratio) < 0.01  # the CMB is not scaled
        assert 0.005 < np.abs(level).max() < 0.15
    elif outside == "lst":
        assert shape.std() == pytest.approx(LST_RMS, rel=0.1)
    else:
        assert 1e-4 < shape.std() < 0.02


def test_worlds_are_drawn_from_everything_and_a_third_lies_outside() -> None:
    rng = np.random.default_rng(1)
    drawn = [draw_world(rng, SKIES[1:], ANTENNAS[1:]) for _ in range(600)]
    assert {world.sky for world in drawn} == set(SKIES[1:])
    assert {world.antenna for world in drawn} == set(ANTENNAS[1:])
    assert {world.noise for world in drawn} == set(NOISES)
    assert np.mean([bool(world.outside) for world in drawn]) == pytest.approx(1 / 3, abs=0.06)  # 3 sigma


@pytest.mark.long
def test_the_view_of_a_world_has_its_sky_and_antenna(low_band: Instrument) -> None:
    seen = []
    for world in (World("lfsm", "inverted-v", "behind"), World("gsm", "hamaker", "behind")):
        power = world.sky_power(low_band).power
        mean = np.mean([power[name].mean(axis=0) for name in "XY"], axis=0)
        seen.append(world.view(low_band).mean_kelvin_sr / mean)
    # K sr over W/MHz is the same nu^-2 for both, if the view is that of the world; pixels at the horizon: 0.5 %.
    np.testing.assert_allclose(seen[0], seen[1], rtol=0.01)


def test_an_unknown_sky_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="half"):
        make_sky("flat")


LST = np.linspace(0, 24, 50, endpoint=False)


def test_the_plain_sum_turns_dipoles_as_the_sky_power_does(low_band: Instrument, view: View) -> None:
    turned = replace(
        low_band, dipole_azimuth_deg={name: arm + 5.0 for name, arm in low_band.dipole_azimuth_deg.items()}
    )
    expected, plain = compute_sky_power(turned), compute_sky_power(low_band)
    ratio = view.ratio(lambda _, pattern: pattern, LST, turned_deg=5.0)[0]
    for row, dipole in enumerate("XY"):
        # Pixels of 3.7 degrees and a spline over 5 MHz; the effect itself is 2 %.
        np.testing.assert_allclose(ratio[row], expected.at(dipole, LST) / plain.at(dipole, LST), atol=2e-4)


def test_a_response_is_one_overhead_and_none_below_the_horizon(view: View) -> None:
    response = view.response(np.array([0.0, 1.0, 2.0]), np.array([0.3, 0.3, 0.3]), np.array([40.0, 60.0]))
    np.testing.assert_allclose(response[:, 0], 1.0, atol=0.005)  # fitted patterns: 0.1 % around the azimuth
    assert np.all(response[:, 2] == 0)
    assert np.all((response[:, 1] > 0) & (response[:, 1] < 1))


def test_the_mean_sky_is_that_of_the_sky_power(low_band: Instrument, view: View) -> None:
    mean = np.mean([compute_sky_power(low_band).power[dipole].mean(axis=0) for dipole in "XY"], axis=0)
    # k_B Z_0 nu^2 / (c^2 R_r) per MHz, R_r = 50 Ohm: eq. total_sky_power_eq
    per_kelvin = 1.380649e-23 * 376.730313668 * (low_band.frequency_mhz * 1e6 / 299_792_458.0) ** 2 / 50 * 1e6
    np.testing.assert_allclose(view.mean_kelvin_sr * per_kelvin, mean, rtol=5e-3)  # pixels at the horizon


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
