from __future__ import annotations

import base64
import io
import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib.image import imread

from lbacal.pages.chart import BAND, BARS, IMAGE, LINE, MARK, POINTS, SPAN, Chart, Series
from lbacal.pages.svg import draw_svg

HOSTILE = "\"><script>alert(1)</script>&'"


def parse(chart: Chart) -> ET.Element:
    (svg,) = ET.fromstring(draw_svg(chart))  # noqa: S314 - our own text
    return svg


def test_values_stand_where_the_axes_say():
    """Linear between the ends that the frame shows: the middle value of the axis lies in its middle."""
    points = Series(POINTS, [0.0, 5.0, 10.0], [0.0, 1.0, 4.0])
    svg = parse(Chart("t", "x", "y", [points], x_limits=(0.0, 10.0), y_limits=(0.0, 4.0)))
    frame = next(path.attrib["d"] for path in svg.iter("path") if path.attrib["class"] == "frame")
    left, top, bottom, right = map(float, re.findall(r"[\d.]+", frame))
    drawn = [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in svg.iter("circle")]
    expected = [(left, bottom), ((left + right) / 2, bottom - (bottom - top) / 4), (right, top)]
    np.testing.assert_allclose(drawn, expected, atol=0.11)


def test_a_logarithmic_axis_has_equal_steps_a_factor():
    svg = parse(Chart("t", "x", "y", [Series(POINTS, [0.0, 1.0, 2.0], [1.0, 10.0, 100.0])], ("linear", "log")))
    low, middle, high = (float(c.attrib["cy"]) for c in svg.iter("circle"))
    assert low - middle == pytest.approx(middle - high, abs=0.11)


def test_a_gap_and_what_lies_outside_are_not_joined():
    line = Series(LINE, [-1.0, 0.0, 1.0, 2.0, 3.0], [9.0, 1.0, None, 2.0, float("nan")])
    svg = parse(Chart("t", "x", "y", [line], x_limits=(0.0, 3.0)))
    (drawn,) = [path.attrib["d"] for path in svg.iter("path") if path.attrib["class"].startswith("line")]
    assert (drawn.count("M"), drawn.count("L")) == (2, 0)


def test_what_a_user_wrote_is_text_wherever_it_stands():
    series = [
        Series(kind, [1.0, 2.0], [0.0, 1.0], [0.0, 1.0], [1.0, 2.0], HOSTILE, titles=[HOSTILE] * 2, links=[HOSTILE] * 2)
        for kind in (BAND, BARS, LINE, MARK, POINTS, SPAN)
    ]
    chart = Chart(HOSTILE, HOSTILE, HOSTILE, series, rows=[HOSTILE, "b"])
    assert "<script" not in draw_svg(chart)
    svg = parse(chart)
    assert svg.attrib["aria-label"] == HOSTILE
    assert HOSTILE in {title.text for title in svg.iter("title")}
    assert {one.attrib["href"] for one in svg.iter("a")} == {HOSTILE}


def test_no_style_and_no_script_stand_in_it():
    drawn = draw_svg(Chart("t", "x", "y", [Series(LINE, [1.0, 2.0], [3.0, 4.0])]))
    assert re.search(r"style=|<style|<script| on\w+=", drawn) is None


def test_an_image_is_coloured_about_zero_and_grey_where_nothing_is_known():
    image = np.array([[-2.0, 0.0], [np.nan, 9.0]])
    svg = parse(Chart("t", "x", "y", [Series(IMAGE, (0, 2), (0, 2), image=image, limit=2.0)]))
    data = next(svg.iter("image")).attrib["href"].removeprefix("data:image/png;base64,")
    pixels = np.round(255 * imread(io.BytesIO(base64.b64decode(data)), format="png")).astype(int)
    (unknown, most), (least, zero) = pixels.tolist()  # the first row of the values is the lowest
    assert (unknown, least, zero, most) == ([150] * 3, [0, 90, 170], [247] * 3, [180, 60, 0])


@pytest.mark.parametrize(
    ("first", "last", "said"),
    [
        ("2014-01-01", "2021-01-01", ["2014", "2015", "2016", "2017", "2018", "2019", "2020", "2021"]),
        ("2014-01-10", "2014-12-20", ["2014-03", "2014-05", "2014-07"]),
        ("2014-01-01", "2014-01-05", ["2014-01-01", "2014-01-02", "2014-01-03", "2014-01-04", "2014-01-05"]),
    ],
)
def test_dates_are_beginnings_of_years_months_and_days(first: str, last: str, said: list[str]):
    limits = tuple(float(np.datetime64(day, "s").astype(int)) for day in (first, last))
    svg = parse(Chart("t", "x", "y", [Series(POINTS, [], [])], ("time", "linear"), limits, width=1040))
    told = [text.text for text in svg.iter("text") if re.fullmatch(r"\d{4}(-\d\d)*", str(text.text))]
    assert told[: len(said)] == said


def test_an_empty_chart_is_drawn():
    for scales in (("linear", "linear"), ("linear", "log"), ("time", "linear")):
        parse(Chart("t", "x", "y", [Series(LINE, [], []), Series(BAND, [], low=[], high=[])], scales))
