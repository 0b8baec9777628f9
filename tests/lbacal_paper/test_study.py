from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.data.lofar import DIPOLES
from lbacal_paper.budget import Budget, measure_electronics, spread_with_cables
from lbacal_paper.shower_study import FITTED, RIGHT, TOTAL, ShowerStudy, describe_terms
from lbacal_paper.stand_in_source import CELL, CHAMBER
from lbacal_paper.study import Study


def test_the_array_fit_finds_what_was_planted(study: Study) -> None:
    for dipole in "XY":
        curve = study.mean_curve(dipole)
        assert curve.c is not None
        # 36 paths and 900 events: a tenth of a per cent, one station's sky gain in common
        assert np.median(np.abs(curve.c / study.campaign.truth.curve(dipole) - 1)) < 0.02


def test_exchanged_letters_fit_the_measured_curve_better(study: Study) -> None:
    chi2 = [sum(one.of(d, has_noise=True).chi2 for d in "XY") for one in (study.comparison, study.exchanged)]
    assert chi2[1] < chi2[0] / 3


def test_a_brighter_sky_scales_c_by_its_root_in_every_channel(budget: Budget) -> None:
    # the noise terms scale with the sky, so half the difference of ln C is exact
    for dipole in DIPOLES:
        assert budget.terms["sky"][dipole] == pytest.approx(np.full(51, budget.sky_fraction / 2), rel=1e-6)


def test_todays_budgets_are_those_of_lbacal_budget(budget: Budget) -> None:
    assert list(budget.today) == ["models", "measured"]
    for one in budget.today.values():
        assert {"antenna pattern", "level of the sky"} <= {term.name for term in one.terms}


def test_a_wider_pattern_changes_c_more_when_the_event_gain_is_weighted(budget: Budget) -> None:
    assert budget.largest("antenna") > 1.5 * budget.largest("antenna, bins weighted alike") > 0.01


def test_the_spread_of_antennas_is_the_gain_spread_that_was_planted(study: Study) -> None:
    # 4 % of power gain is 2 % of C; with 36 paths a polarisation the spread is known to 12 %
    for dipole, spread in measure_electronics(study).items():
        gains = [np.log(one.path_gain[:, DIPOLES.index(dipole)]) for one in study.campaign.truth.stations]
        planted = np.sqrt(np.mean([np.var(one, ddof=1) for one in gains])) / 2
        # errors of C are correlated along frequency, so that the spread is known no better than from 30 numbers
        assert np.median(spread) == pytest.approx(planted, rel=0.35)


def test_cables_left_in_spread_c_far_more_than_the_gains_do(study: Study) -> None:
    assert spread_with_cables(study, "X").max() > 3 * measure_electronics(study)["X"].max()


def test_wrong_calibrations_leave_the_diagonal_and_the_right_one_does_not(showers: ShowerStudy) -> None:
    moved = showers.displacements
    assert abs(moved[RIGHT].significance) < 3
    for name in (CHAMBER, CELL, "+1 sigma: antenna", "+1 sigma: index of the sky", "no dependence on frequency"):
        assert abs(moved[name].difference) > 5 * moved[name].difference_sigma, name
    # a level changes no slope
    assert moved["+1 sigma: sky"].difference == pytest.approx(moved[RIGHT].difference)
    assert abs(moved[FITTED].difference) < 0.5


def test_every_term_of_todays_budgets_moves_the_slopes_by_something_said(showers: ShowerStudy) -> None:
    for terms in showers.terms.values():
        # a level changes no slope, a pattern does, and an error of G_ant is none of a field
        assert terms["antenna pattern"][2] > 0.2
        assert "shape of the antenna gain" not in terms
        parts = [sizes for name, sizes in terms.items() if name != TOTAL]
        assert terms[TOTAL] == pytest.approx(np.linalg.norm(parts, axis=0))
    assert showers.terms["models"]["level of the sky"] == pytest.approx(np.zeros(3), abs=0.01)
    assert len(describe_terms(showers)) == sum(len(terms) for terms in showers.terms.values())
