from __future__ import annotations

import numpy as np
import pytest

from lbacal_paper.shower_study import (
    FITTED,
    RIGHT,
    TOTAL,
    ShowerStudy,
    describe_displacements,
    describe_terms,
)
from lbacal_paper.stand_in_source import CELL, CHAMBER


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


def test_every_term_of_todays_budgets_moves_the_slopes_by_something_said(showers: ShowerStudy) -> None:
    for terms in showers.terms.values():
        # a level changes no slope, a pattern does, and an error of G_ant is none of a field
        assert terms["antenna pattern"][2] > 0.2
        assert "shape of the antenna gain" not in terms
        parts = [sizes for name, sizes in terms.items() if name != TOTAL]
        assert terms[TOTAL] == pytest.approx(np.linalg.norm(parts, axis=0))
    assert showers.terms["models"]["level of the sky"] == pytest.approx(np.zeros(3), abs=0.01)
    assert len(describe_terms(showers)) == sum(len(terms) for terms in showers.terms.values())
