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


def test_a_shift_of_just_what_a_wrong_sign_of_the_longitude_makes_is_this_sign_or_a_clock_in_one_statement() -> None:
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 41.0, -0.92, 0.02), Possibility("longitude sign", 44.0, -0.916)]
    )
    assert (line.check, line.value) == ("place", -0.92)
    assert "the longitude has the wrong sign (-55 min); or a clock that is 55 min ahead" in line.sentence


def test_an_hour_late_is_no_longitude_of_the_wrong_sign_where_that_is_five_minutes_less() -> None:
    """At 6.9 deg a wrong sign shifts sidereal time by 55 min: a year of local winter time was told as this sign."""
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 90.0, -1.0, 0.03), Possibility("longitude sign", 92.0, -0.916)]
    )
    assert line.check == "clock"
    assert "UTC+1 instead of UTC (-60 min); or the longitude has the wrong sign (-55 min)" in line.sentence


def test_a_shift_that_is_no_whole_hour_is_a_clock_or_a_longitude_and_what_decides_is_said() -> None:
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 90.0, 1.4, 0.03), Possibility("longitude sign", 9.0, -0.916)]
    )
    assert (line.check, line.value) == ("clock", 1.4)
    assert ": a clock that is 84 min behind, or a longitude that is 21.0 deg too far west. The sky" in line.sentence
    assert "UTC" not in line.sentence


def test_a_clock_that_is_off_by_a_whole_hour_is_that_of_a_time_zone() -> None:
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 90.0, -2.01, 0.02)])
    assert "the times are of UTC+2 instead of UTC (-120 min); or a clock" in line.sentence
    assert line.unit == "h"


def test_a_unit_that_is_likelier_but_not_certain_is_said_beside_what_is_confirmed() -> None:
    lines = conclude("S1", 0.0, [Possibility("clock", -3.0, 0.01, 0.02), Possibility("dB", 7.0)])
    assert [(line.check, line.verdict) for line in lines] == [("clock", "right"), ("unit", "undecided")]
    assert "perhaps the power is in decibels" in lines[1].sentence


def test_an_hour_lists_what_a_day_would_leave_out() -> None:
    """In drawn hours the truth was up to 6 below the best: an hour named a latitude where arms were turned."""
    told = [Possibility("latitude sign", 40.0, 0.0), Possibility("arms", 34.0, -57.0, 9.0)]
    assert [conclude("S1", 0.0, told, hours)[0].check for hours in (1.0, 23.9)] == ["record", "place"]


def test_a_clock_that_fits_better_than_a_place_of_the_same_shift_is_not_left_out() -> None:
    told = [Possibility("clock", 40.0, 3.47, 0.185), Possibility("latitude for longitude", 36.0, 3.07)]
    assert conclude("S1", 0.0, told)[0].candidates == ("clock", "place")


def test_a_possibility_that_does_not_describe_the_data_either_is_not_named() -> None:
    told = [Possibility("clock", 400.0, 7.1, 0.1, fits=False), Possibility("arms", 3.0, 4.0, 2.0)]
    lines = conclude("S1", 0.0, told, base_fits=False)
    assert [(line.check, line.verdict) for line in lines] == [("clock", "undecided"), ("arms", "undecided")]
    assert "neither the record nor anything else" in lines[0].sentence


def test_a_record_that_does_not_describe_the_data_is_not_confirmed() -> None:
    (line,) = conclude("S1", 0.0, [Possibility("clock", -3.0, 0.01, 0.02)], base_fits=False)
    assert line.verdict == "undecided"


def test_a_clock_far_from_the_record_confirms_nothing() -> None:
    """`right clock: +460 +- 44 min` stood in a report."""
    (line,) = conclude("S1", 0.0, [Possibility("clock", 1.1, 460 / 60, 0.73)])
    assert line.verdict == "undecided"
    assert "not confirmed, and not enough to call it wrong: sidereal time is +460 +- 44 min" in line.sentence
