from __future__ import annotations

import csv

import numpy as np
import pytest

from lbacal_core.paper.budget import compute_budget
from lbacal_core.paper.chain_figures import make_chain_figures
from lbacal_core.paper.figures import Panel, PaperFigure, Series
from lbacal_core.paper.study import Study


def read(figure: PaperFigure) -> list[dict[str, str]]:
    return list(csv.DictReader(line for line in figure.as_csv().splitlines() if not line.startswith("#")))


def test_a_csv_holds_every_number_that_is_drawn() -> None:
    x = np.array([1.0, 2.0])
    series = Series("a, b", x, x**2, low=x, high=np.array([np.nan, 5.0]), kind="points")
    rows = read(PaperFigure(1, "title", "caption", [Panel("nu", "C", [series])]))
    assert [row["y"] for row in rows] == ["1", "4"]
    assert [row["high"] for row in rows] == ["", "5"]
    assert rows[0]["series"] == "a, b"


def test_a_series_with_unequal_lengths_is_refused() -> None:
    with pytest.raises(ValueError, match="short"):
        Series("short", np.zeros(3), np.zeros(2))


def test_figures_1_to_6_have_published_numbers_beside_ours(study: Study) -> None:
    figures = make_chain_figures(study, compute_budget(study), None)
    assert [figure.number for figure in figures] == [1, 2, 3, 4, 5, 6]
    for figure in figures[1:]:
        origins = {one.origin for panel in figure.panels for one in panel.series}
        assert {"ours", "published"} <= origins, figure.title
        assert all(np.all(np.isfinite(one.y)) for panel in figure.panels for one in panel.series)
