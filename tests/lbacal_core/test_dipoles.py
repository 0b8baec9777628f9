from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.instrument.antennas import are_dipole_names, is_dipole_name, look_like_radians


@pytest.mark.parametrize("name", ["X", "y", "EW", "arm-2", "Z_up", "45deg"])
def test_an_arm_may_bear_any_short_name(name):
    assert is_dipole_name(name)


@pytest.mark.parametrize("name", ["", "X Y", "?", "a" * 9, "-X", "sky", "antenna", "É"])
def test_what_could_not_be_a_field_of_a_sky_power_file_is_no_name(name):
    assert not is_dipole_name(name)


def test_names_of_an_array_are_told_one_by_one():
    assert are_dipole_names(np.array(["X", "?", "X"])).tolist() == [True, False, True]


@pytest.mark.parametrize(
    "azimuth_deg", [[45.0, 135.0], [225.0, 315.0], [0.0, 90.0], [0.0, 120.0, 240.0], [0.0, 90.0, 0.0]]
)
def test_arms_in_radians_look_like_radians_and_in_degrees_do_not(azimuth_deg):
    """Arms given in radians converged: two nearly parallel dipoles, and C off by a few per cent."""
    assert look_like_radians(np.radians(azimuth_deg).tolist())
    assert not look_like_radians(azimuth_deg)


@pytest.mark.parametrize("azimuth_deg", [[3.9], [0.0, 0.0], [1.0, 362.0]])
def test_one_arm_and_parallel_arms_may_point_near_the_north(azimuth_deg):
    assert not look_like_radians(azimuth_deg)
