from __future__ import annotations

import numpy as np
import pytest

from validation.machinery.claims import Found
from validation.machinery.parts import Row
from validation.machinery.records import asked_of
from validation.moving import judge, pass_years


@pytest.fixture(scope="module")
def row() -> Row:
    """The antennas of a station are exchanged on a date of its log book: another gain, with tilt and curvature."""
    return pass_years(2)


def test_c_is_right_before_after_and_far_from_what_a_station_did(row: Row) -> None:
    assert (row["kind"], row["who"]) == ("antenna", "station")
    assert np.max(np.abs(list(row["pulls"].values()))) < 3.5
    assert np.min(np.abs(row["station"])) > 5.0, "the mean is what the station is since"


def test_the_judgement_counts_what_was_not_right(row: Row) -> None:
    wrong = {**row, "pulls": {**row["pulls"], "moved_after": [4.0, 4.0, 4.0]}, "found": [[[[0, "X"]], 1, 1, None]]}
    found: dict[str, Found] = {
        one.key: one for one in judge([row, wrong, {**row, "who": "path", "station": [0.1] * 3}])
    }
    assert found["moved_after"].found == pytest.approx(2 / 3)
    assert found["unplanted"].found == pytest.approx(1 / 3)
    assert found.keys() == set(asked_of("moving", "small"))
