"""When two changes are one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from lbacal.instants import DAY_US
from service.storage.changes import DRIFT, INVESTIGATION, Change, Evidence, KeptChange, is_same_date

STEP = Change("CS002", ((0, "X"), (1, "X")), "step", 100 * DAY_US, DAY_US, 0.1, 0.01)
RAMP = replace(STEP, kind="ramp")


@pytest.mark.parametrize(
    ("one", "other", "is_one"),
    [
        (STEP, {}, True),
        (STEP, {"station": "CS003"}, False),
        (STEP, {"kind": "ramp"}, False),
        (STEP, {"paths": ((1, "Y"), (7, "Y"))}, True),
        (STEP, {"paths": ((2, "X"),)}, False),
        (STEP, {"paths": ()}, False),
        (replace(STEP, paths=()), {}, True),
        (STEP, {"date": 102 * DAY_US}, True),
        (STEP, {"date": 150 * DAY_US}, False),
        (STEP, {"size": 0.5}, True),
        (RAMP, {}, True),
        (RAMP, {"size": 0.11}, True),
        (RAMP, {"size": 0.5}, False),
        (RAMP, {"size": None, "size_sigma": None}, False),
        (RAMP, {"paths": ((1, "X"),)}, False),
    ],
)
def test_two_changes_are_one_by_kind_antenna_date_and_what_goes_on_by_size(
    one: Change, other: dict[str, Any], is_one: bool
) -> None:
    changed = replace(one, **other)
    assert (one.is_same(changed), changed.is_same(one)) == (is_one, is_one)


def test_dates_agree_within_a_day_and_their_errors() -> None:
    day = (100 * DAY_US, 0)
    assert is_same_date(day, (101 * DAY_US, 0))
    assert not is_same_date(day, (101 * DAY_US + 1, 0))
    assert not is_same_date((101 * DAY_US + 1, 0), day)
    assert is_same_date(day, (103 * DAY_US, DAY_US))


@pytest.mark.parametrize(
    ("drift_ended", "found_ended", "decision"),
    [(None, None, "in force"), (9, None, "proposed"), (None, 9, "in force"), (9, 9, "in force")],
)
def test_who_says_so_now_decides_whether_a_change_is_in_force(
    drift_ended: int | None, found_ended: int | None, decision: str
) -> None:
    """A step that drift had found once stayed in force for ever where an investigation alone still found it."""
    evidence = Evidence(DRIFT, "", 9.7, 1, drift_ended), Evidence(INVESTIGATION, "7", 26.9, 2, found_ended)
    kept = KeptChange(1, STEP, 1, evidence)
    assert kept.decision == decision.replace(" ", "_")
    assert kept.stands == (drift_ended is None)
