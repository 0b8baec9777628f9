"""A small instance of `./dev prove described`."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lbacal_twin.faults.composed import COURSES, Composed
from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.described import (
    ALIKE,
    PLACES,
    judge_one_size,
    judge_unlisted,
    number_in_halves,
    try_composed,
    try_left_out,
    try_unlisted,
)
from validation.hidden.data_sets import moving_causes
from validation.machinery.records import verdicts_of


def test_every_effect_has_a_place() -> None:
    kinds = {kind.__name__ for kind in uncatalogued_faults().values()} | {*moving_causes()}
    assert kinds <= PLACES.keys()


def test_a_record_of_right_sentences_is_shown_and_one_of_wrong_places_is_not() -> None:
    row = {
        "kind": "WorkingWeek",
        "snr": 25.0,
        "verdict": "unexplained",
        "places": ["receiver"],
        "alike": [0.99],
        "kept": 0.97,
    }
    right, wrong = [row] * 60, [row | {"places": ["sky"], "alike": [0.5]}] * 60
    assert verdicts_of("described", "unlisted", right)["law"] == "shown"
    assert verdicts_of("described", "unlisted", right)["place_in_set"] == "shown"
    assert verdicts_of("described", "unlisted", wrong)["law"] == "refuted"
    assert verdicts_of("described", "unlisted", wrong)["place_in_set"] == "refuted"
    silent = {**row, "verdict": "consistent", "places": [], "alike": [], "kept": None}
    unmade = {**silent, "verdict": ""}
    assert str(judge_one_size([row, silent, unmade])[:2]) == str(judge_one_size([row, silent])[:2])
    assert str(judge_one_size([row, silent])[1]) != str(judge_one_size([row, row])[1])
    assert len(judge_unlisted(right)) > len(judge_one_size(right))


def test_every_fourth_event_is_planted_in_both_halves_as_each_counts_them() -> None:
    scene = SimpleNamespace(time_unix=np.arange(101.0))
    fault = number_in_halves(Composed(size=0.1, place="sky", law=("level", ()), courses=(("third", (4.0,)),)))
    ((name, numbers),) = fault.courses
    planted = COURSES[name][0](scene, *numbers)
    for half in (planted[0::2], planted[1::2]):
        assert np.flatnonzero(half).tolist() == [*range(0, half.size, 4)]


@pytest.mark.long
def test_working_days_are_said_in_words_that_hold_in_other_events() -> None:
    row = try_unlisted(1)
    assert row["kind"] == "WorkingWeek"
    assert row["places"][0] == "receiver"
    assert row["alike"][0] > ALIKE
    assert row["kept"] > 0.9


@pytest.mark.long
@pytest.mark.parametrize(("seed", "kind", "place"), [(21, "solar_emission", "Sun"), (16, "point_source", "Tau A")])
def test_a_source_is_said_where_no_cause_of_the_catalogue_is_one(seed: int, kind: str, place: str) -> None:
    row = try_left_out(seed)
    assert (row["kind"], row["places"][:1]) == (kind, [place])
    assert row["alike"][0] > ALIKE


@pytest.mark.long
def test_other_parts_run() -> None:
    composed, left_out = try_composed(4), try_left_out(8)
    assert max(composed["alike"]) > ALIKE
    assert left_out["kind"] not in left_out["named"]


@pytest.mark.long
def test_what_grows_from_antenna_to_antenna_is_judged_by_the_amount_of_each() -> None:
    """No single antenna or cable resembles a gradient by more than 0.75."""
    row = try_unlisted(4)
    assert row["kind"] == "FieldGradient"
    assert row["alike"][0] > 0.9
