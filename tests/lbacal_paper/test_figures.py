from __future__ import annotations

import csv

import numpy as np
import pytest

from lbacal_paper.figures import Panel, PaperFigure, Series


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
