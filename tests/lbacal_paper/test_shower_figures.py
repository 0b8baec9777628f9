from __future__ import annotations

import numpy as np

from lbacal_paper.budget import Budget
from lbacal_paper.shower_figures import make_shower_figures
from lbacal_paper.shower_study import ShowerStudy
from lbacal_paper.study import Study


def test_figures_7_to_9_call_the_stand_in_a_stand_in(study: Study, budget: Budget, showers: ShowerStudy) -> None:
    figures = make_shower_figures(study, budget, showers)
    assert [figure.number for figure in figures] == [7, 8, 9]
    for figure in figures:
        assert "stand-in" in figure.caption
        assert "not public" in figure.caption
        assert all(np.all(np.isfinite(one.y)) for panel in figure.panels for one in panel.series)
