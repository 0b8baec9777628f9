from __future__ import annotations

from lbacal_core.audit.verdict import Possibility, conclude


def test_a_record_that_nothing_beats_is_confirmed_where_the_data_determine_it() -> None:
    lines = conclude("CS002", 0.0, [Possibility("clock", -3.0, 0.01, 0.02), Possibility("arms", -3.0, 1.0, 30.0)])
    assert [(line.check, line.verdict) for line in lines] == [("clock", "right"), ("arms", "undecided")]


def test_possibilities_that_are_as_likely_are_all_named_and_none_is_chosen() -> None:
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 40.0, 6.2, 0.3), Possibility("exchange", 38.0)])
    assert (line.check, line.verdict, line.candidates) == ("record", "wrong", ("clock", "exchange"))
    assert "a sidereal day would" in line.sentence


def test_arms_turned_by_about_a_right_angle_are_an_exchange_of_letters() -> None:
    (line,) = conclude("CS002", 0.0, [Possibility("arms", 41.0, -80.0, 6.0), Possibility("exchange", 40.0)])
    assert line.check == "exchange"


def test_a_clock_that_is_off_by_just_what_a_wrong_sign_of_the_longitude_makes_is_this_sign() -> None:
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 41.0, -0.92, 0.03), Possibility("longitude sign", 40.0, -0.916)]
    )
    assert (line.check, line.sentence) == ("place", "the longitude has the wrong sign")


def test_a_clock_that_is_off_by_a_whole_hour_is_that_of_a_time_zone() -> None:
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 90.0, -2.01, 0.02)])
    assert line.sentence.endswith("(times as of UTC+2 would be)")
    assert line.unit == "h"
