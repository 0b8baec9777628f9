from __future__ import annotations

import re

import numpy as np
from matplotlib.figure import Figure

from lbacal.cli.fit_page import draw_page
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.provenance import Provenance

FREQUENCY = np.arange(30.0, 81.0)
C = np.full(51, 2e-5)


def report(curves: int) -> FitReport:
    budget = Budget(FREQUENCY, (BudgetTerm("sky <level>", "a test", {"X": np.full((1, 51), 0.06)}),))
    made = [
        CalibrationCurve("CS002", k, "X", "converged", 900, FREQUENCY, C, 0.01 * C, 0.1 * C, 1.1, 1.0, {})
        for k in range(curves)
    ]
    provenance = Provenance({"spectra": "abc"}, {}, notes={"sky_power": "sky gsm"})
    return FitReport(tuple(made), provenance, budgets={budget.digest: budget})


def test_the_page_is_one_file_with_table_budget_figure_and_the_number() -> None:
    page = draw_page(report(2), Figure(), "S.h5", ["error of C for one event on one antenna: 11 %"])
    assert re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) == []
    for text in ("of S.h5</h1>", "for one event on one antenna: 11 %", "CS002 antenna 1 X", "sky gsm", "6.0"):
        assert text in page
    assert "sky &lt;level&gt;" in page
    assert "<details>" not in page


def test_many_curves_are_folded_away_below_their_summary() -> None:
    page = draw_page(report(40), Figure(), "S.h5", ["number"])
    assert "All 40 curves" in page
    assert page.index("CS002 X") < page.index("<details>") < page.index("CS002 antenna 39 X")
