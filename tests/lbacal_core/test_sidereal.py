from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from astropy import units as u
from astropy.time import Time
from astropy.utils import iers

from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S, local_sidereal_time

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
def test_sidereal_time_is_within_two_seconds_of_the_apparent_one(longitude: float) -> None:
    apparent = Time(INSTANTS, format="unix").sidereal_time("apparent", longitude * u.deg).to_value(u.hourangle)
    assert np.abs(seconds_apart(local_sidereal_time(INSTANTS, longitude), apparent)).max() < 2.0


def test_what_separates_it_from_the_mean_one_is_ut1_alone() -> None:
    time = Time(INSTANTS, format="unix")
    mean = time.sidereal_time("mean", LONGITUDE * u.deg).to_value(u.hourangle)
    behind = seconds_apart(local_sidereal_time(INSTANTS, LONGITUDE), mean)
    # sidereal seconds; 0.1 ms: precession between UTC and TT (7 us), the digits of both doubles, the tables of UT1
    np.testing.assert_allclose(behind, -1.002_737_9 * time.delta_ut1_utc, atol=1e-4)
    assert np.abs(behind).max() < 0.9


def test_it_is_the_rotation_and_the_precession_of_the_paper() -> None:
    # Capitaine, Wallace & Chapront 2003, eq. 42, by hand, with UTC for UT1 and TT and without the terms below 1 us
    days = (INSTANTS - 946_728_000.0) / 86_400.0
    rotation = 0.779_057_273_264_0 + 0.002_737_811_911_354_48 * days + days % 1.0
    centuries = days / 36_525.0
    precession_arcsec = 0.014_506 + (4_612.156_534 + 1.391_581_7 * centuries) * centuries
    by_hand = (24.0 * rotation + precession_arcsec / 54_000.0 + LONGITUDE / 15.0) % 24.0
    # 1 us: a double that counts seconds from 1970 has steps of 0.24 us
    np.testing.assert_allclose(seconds_apart(local_sidereal_time(INSTANTS, LONGITUDE), by_hand), 0.0, atol=1e-6)


def test_a_sidereal_day_later_the_sky_is_the_same() -> None:
    one, other = (local_sidereal_time(INSTANTS + shift, LONGITUDE) for shift in (0.0, SIDEREAL_DAY_S))
    assert np.abs(seconds_apart(one, other)).max() < 1e-3


def test_fifteen_degrees_east_is_an_hour_later() -> None:
    east = local_sidereal_time(INSTANTS, LONGITUDE + 15.0)
    np.testing.assert_allclose(seconds_apart(east, local_sidereal_time(INSTANTS, LONGITUDE)), 3600.0, atol=1e-6)


def test_hours_stay_below_24_and_keep_the_shape() -> None:
    lst = local_sidereal_time(INSTANTS.reshape(20, 20), LONGITUDE)
    assert lst.shape == (20, 20)
    assert lst.min() >= 0.0
    assert lst.max() < 24.0
