from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from lbacal_twin.campaign import Campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import START_2014, YEAR_S
from validation.machinery.claims import Found
from validation.machinery.parts import Row
from validation.machinery.records import asked_of
from validation.moving import SINGLE, YEARS, Moving, draw_move, judge, pass_years


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
        dates = Moving(cast("Campaign", None), [draw_move(kind, Where(), rng)]).dates().values()
        assert START_2014 < min(dates) < max(dates) < end


def test_the_judgement_counts_what_was_not_right(row: Row) -> None:
    wrong = {**row, "pulls": {**row["pulls"], "moved_after": [4.0, 4.0, 4.0]}, "found": [[[[0, "X"]], 1, 1, None]]}
    found: dict[str, Found] = {
        one.key: one for one in judge([row, wrong, {**row, "who": "path", "station": [0.1] * 3}])
    }
    assert found["moved_after"].found == pytest.approx(2 / 3)
    assert found["unplanted"].found == pytest.approx(1 / 3)
    assert found.keys() == set(asked_of("moving", "small"))
