from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from lbacal_twin.campaign import Campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import START_2014, YEAR_S
from validation.machinery.claims import Found
from validation.machinery.parts import Row
from validation.machinery.records import asked_of
from validation.moving import SINGLE, YEARS, Moving, compare_means, draw_move, judge, judge_means, pass_years


@pytest.fixture(scope="module")
def row() -> Row:
    """The antennas of a station are exchanged on a date of its log book: another gain, with tilt and curvature."""
    return pass_years(2)


def test_c_is_right_before_after_and_far_from_what_a_station_did(row: Row) -> None:
    assert (row["kind"], row["who"]) == ("antenna", "station")
    assert np.max(np.abs(list(row["pulls"].values()))) < 3.5
    assert np.min(np.abs(row["station"])) > 5.0, "the mean is what the station is since"


def test_c_is_asked_for_while_there_are_data() -> None:
    """After the end of the data nothing is in effect: 10 of 51 antennas that were dead for a year had no C far away."""
    rng, end = np.random.default_rng(1), START_2014 + YEARS * YEAR_S
    for kind in SINGLE * 50:
        dates = Moving(cast("Campaign", None), cast("Any", None), [draw_move(kind, Where(), rng)]).dates().values()
        assert START_2014 < min(dates) < max(dates) < end


def test_the_judgement_counts_what_was_not_right(row: Row) -> None:
    wrong = {**row, "pulls": {**row["pulls"], "moved_after": [4.0, 4.0, 4.0]}, "found": [[[[0, "X"]], 1, 1, None]]}
    single = {**row, "who": "path", "station": [0.1] * 3, "planted": [["step", 1, [0.1], 0.0, [3]]]}
    elsewhere = {**single, "found": [[[[3, "X"]], 1, 1, 0], [[[0, "X"]], 1, 1, None]]}
    found: dict[str, Found] = {one.key: one for one in judge([row, wrong, single, elsewhere])}
    assert found["moved_after"].found == pytest.approx(3 / 4)
    assert (found["unplanted"].found, found["other_kind"].found) == (1 / 4, 1 / 4)
    assert found.keys() == set(asked_of("moving", "small")) == set(asked_of("moving", "large"))


def test_an_antenna_that_is_dead_for_a_year_does_not_move_the_mean_of_its_station() -> None:
    """The mean was that of the other antennas then, and between two fits by its departure from them."""
    row = {"seed": 5, **compare_means(5)}
    assert (row["kind"], len(row["station"])) == ("dead", 2)
    assert np.abs(row["station"]).max() < 0.3
    moved = {"station": [[0.1] * 3, [0.1, 0.1, -0.4]], "found": [[[[0, "X"]], 1, 1, None]]}
    others = [{**row, "seed": 6, "kind": "several"}, {**row, "seed": 7, "kind": "step", **moved}]
    found = {one.key: one for one in judge_means([row, *others])}
    assert [found[key].found for key in ("mean", "mean_dead", "mean_several", "unplanted")] == [0, 1, 1, 0.5]
    assert found.keys() == set(asked_of("moving", "mean"))
