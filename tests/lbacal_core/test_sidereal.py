from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from astropy import units as u
from astropy.time import Time
from astropy.utils import iers

from lbacal_core.grids import Floats
from lbacal_core.sidereal import SIDEREAL_DAY_S, local_sidereal_time

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
    # 5 ms: the precession of the seconds between UT1 and TT, and the digits of a double that counts from 1970
    np.testing.assert_allclose(behind, -time.delta_ut1_utc, atol=5e-3)
    assert np.abs(behind).max() < 0.9


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
