from __future__ import annotations

import numpy as np

from lbacal_paper.budget import Budget
from lbacal_paper.chain_figures import make_chain_figures
from lbacal_paper.study import Study


def test_figures_1_to_6_have_published_numbers_beside_ours(study: Study, budget: Budget) -> None:
    figures = make_chain_figures(study, budget, None)
    assert [figure.number for figure in figures] == [1, 2, 3, 4, 5, 6]
    for figure in figures[1:]:
        origins = {one.origin for panel in figure.panels for one in panel.series}
        assert {"ours", "published"} <= origins, figure.title
        assert all(np.all(np.isfinite(one.y)) for panel in figure.panels for one in panel.series)
