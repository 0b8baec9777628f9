"""A small instance of `./dev prove loop`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from validation.loop import AIMED, MOVED, SETTINGS, close_loop
from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of


@pytest.fixture(scope="module")
def row() -> Row:
    """A clock that is off, on a station of two antennas with few events."""
    return close_loop("sqlite", replace(SETTINGS, antennas=2, events_per_year=200), 1)


def test_the_fault_is_named_and_with_it_c_is_right_again(row: Row) -> None:
    assert (row["fault"], row["is_named"], row["left"]) == ("lst_offset", True, "consistent")
    assert MOVED < row["moved"] < AIMED + 1.0
    assert row["wrong"] < 0.5
    assert row["is_in_effect"]


def test_the_first_year_is_helped_by_years_that_are_right_again(row: Row) -> None:
    assert row["first"] < 0.5


def test_withdrawal_restores_what_was_told_bit_by_bit(row: Row) -> None:
    assert row["is_restored"]


def test_the_size_is_that_planted_and_the_gain_on_the_next_year_what_was_promised(row: Row) -> None:
    value, error = row["adopted"]
    assert abs(value - row["size"]) < 4 * error
    gain, expected, sigma = row["gain"]
    assert abs(gain - expected) < 3 * sigma
    assert abs(gain - row["promise"][0]) < 3 * row["promise"][1]


def test_the_judgement_refutes_a_loop_that_does_not_close(row: Row) -> None:
    broken = [{**row, "wrong": 4.0, "left": "unexplained", "gain": [0.0, *row["gain"][1:]], "is_restored": False}] * 20
    verdict = verdicts_of("loop", "together", [row, *broken])
    assert [verdict[key] for key in ("right", "left", "gain", "restored")] == ["refuted"] * 4
