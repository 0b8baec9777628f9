from __future__ import annotations

import pytest

from lbacal_core.paper.shower_study import FITTED, RIGHT, ShowerStudy, describe_displacements
from lbacal_core.paper.stand_in_source import CELL, CHAMBER


def test_wrong_calibrations_leave_the_diagonal_and_the_right_one_does_not(showers: ShowerStudy) -> None:
    moved = showers.displacements
    assert abs(moved[RIGHT].significance) < 3
    for name in (CHAMBER, CELL, "+1 sigma: antenna", "+1 sigma: index of the sky", "no dependence on frequency"):
        assert abs(moved[name].difference) > 5 * moved[name].difference_sigma, name
    # a level changes no slope
    assert moved["+1 sigma: sky"].difference == pytest.approx(moved[RIGHT].difference)
    assert abs(moved[FITTED].difference) < 0.5


def test_every_calibration_stands_in_the_table(showers: ShowerStudy) -> None:
    assert [row[0] for row in describe_displacements(showers)] == list(showers.displacements)
