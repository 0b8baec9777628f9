"""A small instance of `./dev prove judge`."""

from __future__ import annotations

import pytest

from validation.judge import judge_names, judge_one, judge_unlisted, try_nothing, try_one, try_unlisted, try_waves
from validation.machinery.records import verdicts_of


def test_a_lost_name_and_a_new_wrong_one_are_counted_and_a_gained_one_is_not() -> None:
    row = {"cause": "gain_step", "label": "station", "pull": 0.5}
    kept = row | {"compete": [["gain_step"]], "search": [["gain_step"]]}
    lost = row | {"compete": [], "search": [["gain_step"]], "pull": None}
    gained = row | {"compete": [["gain_step"]], "search": [["gain_drift"]]}
    wrong = row | {"compete": [["gain_step"], ["rfi_line"]], "search": [["gain_step"]]}
    assert set(verdicts_of("judge", "one", [kept] * 400).values()) == {"shown", "measured"}
    assert verdicts_of("judge", "one", [kept] * 350 + [lost] * 50)["lost"] == "refuted"
    assert verdicts_of("judge", "one", [kept] * 350 + [wrong] * 50)["misnamed_alone"] == "refuted"
    assert verdicts_of("judge", "one", [kept] * 350 + [gained] * 50)["lost"] == "shown"
    unmade = {"cause": "gain_step", "label": ""}
    assert str(judge_one([kept, unmade])) == str(judge_one([kept]))


def test_names_of_effects_without_a_cause_are_counted_for_each_judge() -> None:
    quiet = {"verdict": "unexplained", "named": [], "axis": "utc", "is_right_axis": True}
    named = quiet | {"named": ["gain_step"], "is_right_axis": False}
    right, wrong = ({"made": True, "compete": one, "search": quiet} for one in (quiet, named))
    assert verdicts_of("judge", "unlisted", [right] * 100)["compete_forced"] == "shown"
    refuted = verdicts_of("judge", "unlisted", [wrong] * 100)
    assert (refuted["compete_forced"], refuted["lost"]) == ("refuted", "refuted")
    assert verdicts_of("judge", "waves", [wrong] * 100)["compete_named"] == "refuted"
    assert str(judge_unlisted([right, {"made": False}])) == str(judge_unlisted([right]))
    assert str(judge_names([wrong])[0]) != str(judge_names([right])[0])


@pytest.mark.long
def test_both_judges_name_an_effect_and_neither_names_what_no_catalogue_lists() -> None:
    one, hum = try_one(8), try_unlisted(0)
    assert (one["cause"], one["compete"], one["search"]) == ("gain_step", [["gain_step"]], [["gain_step"]])
    assert abs(one["pull"]) < 4.0
    assert (hum["kind"], hum["compete"]["named"], hum["compete"]["axis"]) == ("MainsHum", [], "utc")


@pytest.mark.long
def test_gains_that_follow_time_get_no_name_and_nothing_is_said_of_nothing() -> None:
    wave, nothing = try_waves(3), try_nothing(1)
    assert wave["compete"]["verdict"] == "unexplained"
    assert wave["compete"]["named"] == []
    assert nothing["compete"]["verdict"] == "consistent"
