"""Tables of others, turned to the arm."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.files import grid_rows, turn_to_arm
from lbacal_core.errors import BadInputError


def turn(one, theta, phi):
    return turn_to_arm("x", "x.xml", [one.frequency_mhz, one.zenith_deg, one.phi_deg], theta, phi, has_level=True)


def test_the_arm_is_found_in_the_pattern_wherever_it_lies(tabulated):
    tabulated.require_the_same(turn(tabulated, tabulated.theta, tabulated.phi))


def test_an_antenna_that_answers_to_every_direction_alike_has_no_arm(tabulated):
    quarter = tabulated.phi_deg.size // 4
    crossed_theta = tabulated.theta + 1j * np.roll(tabulated.theta, quarter, axis=2)
    crossed_phi = tabulated.phi + 1j * np.roll(tabulated.phi, quarter, axis=2)
    with pytest.raises(BadInputError, match=r"expected one arm: 90% of the response at zenith .* found 50%"):
        turn(tabulated, crossed_theta, crossed_phi)


def test_rows_come_in_any_order_and_a_hole_is_named():
    frequency, zenith, phi = (np.array(one, dtype=float) for one in ([30, 30, 30, 30], [0, 0, 5, 5], [90, 360, 90, 0]))
    axes, (grid,) = grid_rows("x", (frequency, zenith, phi), (np.array([2.0, 1.0, 4.0, 3.0], dtype=complex),))
    assert [axis.tolist() for axis in axes] == [[30.0], [0.0, 5.0], [0.0, 90.0]]
    np.testing.assert_array_equal(grid[0], [[1.0, 2.0], [3.0, 4.0]])
    with pytest.raises(BadInputError, match="found none at 30 MHz, 5, 0 deg"):
        grid_rows("x", (frequency[:3], zenith[:3], phi[:3]), (np.ones(3, dtype=complex),))
