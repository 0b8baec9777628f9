from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.data.lofar import DIPOLES
from lbacal_paper.budget import Budget, measure_electronics, spread_with_cables
from lbacal_paper.study import Study


def test_a_brighter_sky_scales_c_by_its_root_in_every_channel(budget: Budget) -> None:
    # the noise terms scale with the sky, so half the difference of ln C is exact
    for dipole in DIPOLES:
        assert budget.terms["sky"][dipole] == pytest.approx(np.full(51, budget.sky_fraction / 2), rel=1e-6)


def test_todays_budgets_are_those_of_lbacal_budget(budget: Budget) -> None:
    assert list(budget.today) == ["models", "measured"]
    for one in budget.today.values():
        assert {"antenna pattern", "level of the sky"} <= {term.name for term in one.terms}


def test_the_total_is_the_quadrature_of_its_terms(budget: Budget) -> None:
    parts = [budget.terms[name]["X"] for name in ("sky", "antenna", "electronics")]
    assert budget.total("X") == pytest.approx(np.sqrt(sum(part**2 for part in parts)))


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
