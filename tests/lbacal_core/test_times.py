from collections.abc import Iterator
from datetime import UTC, datetime

import erfa
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, get_sun
from astropy.time import Time
from astropy.utils import iers

from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S, local_sidereal_time, sun_position

LONGITUDE = 6.8698
INSTANTS = np.random.default_rng(1).uniform(1_230_768_000.0, 1_735_689_600.0, 400)  # 2009 to 2025


@pytest.fixture(autouse=True)
def _offline() -> Iterator[None]:
    with iers.conf.set_temp("auto_download", False):
        yield


def seconds_apart(ours: Floats, theirs: Floats) -> Floats:
    """Difference of two sidereal times on the clock, s."""
    return ((ours - theirs + 12.0) % 24.0 - 12.0) * 3600.0


@pytest.mark.parametrize("longitude", [-69.5, 0.0, LONGITUDE, 180.0])
def test_sidereal_time_is_within_two_seconds_of_the_apparent_one(longitude):
    apparent = Time(INSTANTS, format="unix").sidereal_time("apparent", longitude * u.deg).to_value(u.hourangle)
    assert np.abs(seconds_apart(local_sidereal_time(INSTANTS, longitude), apparent)).max() < 2.0


def test_what_separates_it_from_the_mean_one_is_ut1_alone():
    time = Time(INSTANTS, format="unix")
    mean = time.sidereal_time("mean", LONGITUDE * u.deg).to_value(u.hourangle)
    behind = seconds_apart(local_sidereal_time(INSTANTS, LONGITUDE), mean)
    # sidereal seconds; 0.1 ms: precession between UTC and TT (7 us), the digits of both doubles, the tables of UT1
    np.testing.assert_allclose(behind, -1.002_737_9 * time.delta_ut1_utc, atol=1e-4)
    assert np.abs(behind).max() < 0.9


def test_it_is_the_rotation_and_the_precession_of_the_paper():
    # Capitaine, Wallace & Chapront 2003, eq. 42, by hand, with UTC for UT1 and TT and without the terms below 1 us
    days = (INSTANTS - 946_728_000.0) / 86_400.0
    rotation = 0.779_057_273_264_0 + 0.002_737_811_911_354_48 * days + days % 1.0
    centuries = days / 36_525.0
    precession_arcsec = 0.014_506 + (4_612.156_534 + 1.391_581_7 * centuries) * centuries
    by_hand = (24.0 * rotation + precession_arcsec / 54_000.0 + LONGITUDE / 15.0) % 24.0
    # 1 us: a double that counts seconds from 1970 has steps of 0.24 us
    np.testing.assert_allclose(seconds_apart(local_sidereal_time(INSTANTS, LONGITUDE), by_hand), 0.0, atol=1e-6)


def test_a_sidereal_day_later_the_sky_is_the_same_and_hours_stay_below_24_and_keep_the_shape():
    one, other = (local_sidereal_time(INSTANTS + shift, LONGITUDE) for shift in (0.0, SIDEREAL_DAY_S))
    assert np.abs(seconds_apart(one, other)).max() < 1e-3
    assert local_sidereal_time(INSTANTS.reshape(20, 20), LONGITUDE).shape == (20, 20)
    assert one.min() >= 0.0
    assert one.max() < 24.0


LATITUDE = 52.9153


def hours_of(day):
    start = datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()
    return start + np.arange(0, 86_400, 30.0)


@pytest.mark.parametrize(
    ("day", "declination"), [("2014-06-21", 23.44), ("2014-12-21", -23.44), ("2014-03-20", 0.0), ("2014-09-23", 0.0)]
)
def test_the_noon_altitude_is_that_of_the_season(day, declination):
    altitude, azimuth = sun_position(hours_of(day), LATITUDE, LONGITUDE)
    noon = int(np.argmax(altitude))
    # 0.3 degrees: the equinoxes are not at noon, and the Sun's declination moves by 0.4 degrees a day.
    assert np.degrees(altitude[noon]) == pytest.approx(90.0 - LATITUDE + declination, abs=0.3)
    assert np.degrees(azimuth[noon]) % 360 == pytest.approx(180.0, abs=1.0)


def test_local_noon_follows_longitude_and_the_equation_of_time():
    times = hours_of("2014-11-03")  # the Sun is 16.4 minutes early
    altitude, _ = sun_position(times, LATITUDE, LONGITUDE)
    noon = (times[np.argmax(altitude)] % 86_400) / 3600
    assert noon == pytest.approx(12.0 - LONGITUDE / 15.0 - 16.4 / 60, abs=0.03)


def test_the_day_of_an_equinox_lasts_twelve_hours_and_the_sun_rises_in_the_east():
    times = hours_of("2014-03-20")
    altitude, azimuth = sun_position(times, LATITUDE, LONGITUDE)
    assert np.mean(altitude > 0) * 24 == pytest.approx(12.0, abs=0.1)
    rising = int(np.flatnonzero((altitude[1:] > 0) & (altitude[:-1] <= 0))[0])
    assert np.degrees(azimuth[rising]) % 360 == pytest.approx(90.0, abs=1.0)


def test_the_sun_stands_where_astropy_has_it():
    times = np.random.default_rng(7).uniform(1_230_768_000.0, 1_735_689_600.0, 300)  # 2009 to 2025
    place = EarthLocation.from_geodetic(LONGITUDE * u.deg, LATITUDE * u.deg)
    when = Time(times, format="unix")
    seen = get_sun(when).transform_to(AltAz(obstime=when, location=place))
    altitude, azimuth = sun_position(times, LATITUDE, LONGITUDE)
    # 0.006 deg of aberration, 0.005 deg of nutation, 0.004 deg of UT1 - UTC, 0.002 deg of parallax
    assert np.degrees(erfa.seps(azimuth, altitude, seen.az.rad, seen.alt.rad)).max() < 0.02


def test_the_sun_stands_where_the_series_of_the_almanac_has_it():
    # The Astronomical Almanac's low-precision formulae (0.01 deg, 1950-2050) and the spherical triangle by hand.
    times = np.random.default_rng(7).uniform(1_230_768_000.0, 1_735_689_600.0, 500)  # 2009 to 2025
    days = (times - 946_728_000.0) / 86_400.0
    anomaly = np.radians(357.528 + 0.9856003 * days)
    mean_longitude = 280.460 + 0.9856474 * days
    longitude = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.radians(23.439 - 0.0000004 * days)
    right_ascension = np.arctan2(np.cos(obliquity) * np.sin(longitude), np.cos(longitude))
    declination = np.arcsin(np.sin(obliquity) * np.sin(longitude))
    hour_angle = np.radians(15.0 * local_sidereal_time(times, LONGITUDE)) - right_ascension
    latitude = np.radians(LATITUDE)
    up = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour_angle)
    east = -np.cos(declination) * np.sin(hour_angle)
    north = np.sin(declination) * np.cos(latitude) - np.cos(declination) * np.sin(latitude) * np.cos(hour_angle)
    altitude, azimuth = sun_position(times, LATITUDE, LONGITUDE)
    apart = np.degrees(erfa.seps(azimuth, altitude, np.arctan2(east, north), np.arcsin(up)))
    # 0.01 deg of the series and 0.006 deg of aberration, which the series has and ours has not
    assert apart.max() < 0.016
