from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.dipoles import are_dipole_names, is_dipole_name


@pytest.mark.parametrize("name", ["X", "y", "EW", "arm-2", "Z_up", "45deg"])
def test_an_arm_may_bear_any_short_name(name):
    assert is_dipole_name(name)


@pytest.mark.parametrize("name", ["", "X Y", "?", "a" * 9, "-X", "sky", "antenna", "É"])
def test_what_could_not_be_a_field_of_a_sky_power_file_is_no_name(name):
    assert not is_dipole_name(name)


def test_names_of_an_array_are_told_one_by_one():
    assert are_dipole_names(np.array(["X", "?", "X"])).tolist() == [True, False, True]
