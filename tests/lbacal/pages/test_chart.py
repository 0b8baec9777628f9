from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from matplotlib.figure import Figure

from lbacal.pages.chart import BAND, IMAGE, LINE, POINTS, Chart, Series

IMAGE_OF = np.array([[1.0, np.nan], [3.0, 4.0]])


def test_csv_holds_the_numbers_drawn_and_no_formula():
    series = [
        Series(POINTS, [0.0, 86_400.0], [1.5, None], [1.0, None], [2.0, None], name="=1+1"),
        Series(BAND, [0.0], low=[3.0], high=[4.0], name='a "b"'),
    ]
    rows = list(csv.reader(io.StringIO(Chart("t", "date", "C", series, ("time", "linear")).csv())))
    assert rows == [
        ["series", "date", "C", "low", "high"],
        ["'=1+1", "1970-01-01T00:00:00Z", "1.5", "1", "2"],
        ["'=1+1", "1970-01-02T00:00:00Z", "", "", ""],
        ['a "b"', "1970-01-01T00:00:00Z", "", "3", "4"],
    ]


def test_csv_of_an_image_has_a_line_a_cell_at_its_middle():
    chart = Chart("t", "x", "y", [Series(IMAGE, (0.0, 4.0), (0.0, 2.0), name="%", image=IMAGE_OF)])
    rows = list(csv.reader(io.StringIO(chart.csv())))[1:]
    assert rows[0] == ["% 1", "1", "0.5", "", ""]
    assert rows[3] == ["% 4", "3", "1.5", "", ""]


def test_matplotlib_draws_the_same_numbers():
    axes = Figure().subplots()
    Chart("t", "x", "y", [Series(LINE, [1.0, 2.0], [3.0, None], name="a")], y_limits=(0.0, 5.0)).draw(axes)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [3.0, np.nan])
    assert axes.get_ylim() == (0.0, 5.0)


def test_a_band_on_a_band_is_darker_in_the_legend_too():
    axes = Figure().subplots()
    x, ends = [1.0, 2.0], {"low": [0.0, 0.0], "high": [1.0, 1.0]}
    Chart("t", "x", "y", [Series(BAND, x, **ends, name="a"), Series(BAND, x, **ends, name="b", style=1)]).draw(axes)
    light, dark = axes.get_legend().get_patches()
    assert light.get_facecolor()[3] < dark.get_facecolor()[3]


def test_the_legend_hides_nothing():
    """That of an error budget lay on its terms and on their total, that of a chain on its curves."""
    figure = Figure(figsize=(5, 3), layout="constrained")
    axes = figure.subplots()
    x, ends = [30.0, 80.0], np.cumsum([[0.0, 0.0], *[[1.0, 2.0]] * 6], axis=0)
    bands = [Series(BAND, x, low=ends[k], high=ends[k + 1], name=f"term {k} of the budget") for k in range(6)]
    Chart("t", "x", "y", [*bands, Series(LINE, x, ends[-1], name="total")], y_limits=(0.0, 12.0)).draw(axes)
    figure.draw_without_rendering()
    legend = axes.get_legend().get_window_extent()
    assert axes.get_window_extent().y1 <= legend.y0 < legend.y1 <= axes.title.get_window_extent().y0
    assert figure.bbox.x0 <= legend.x0 < legend.x1 <= figure.bbox.x1
    assert axes.get_xlabel() == "x"


@pytest.mark.parametrize("kind", ["bars", "span", "mark", "image"])
def test_every_kind_is_drawn_with_matplotlib(kind: str):
    figure = Figure()
    one = Series(kind, [1.0, 2.0], [0.0, 1.0], image=IMAGE_OF)
    Chart("t", "x", "y", [one], rows=["a", "b"]).draw(figure.subplots())
    figure.canvas.draw()
