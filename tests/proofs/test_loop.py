"""A small instance of `./dev prove loop`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from proofs.loop import FAULTS, MOVED, SETTINGS, close_loop, judge, tell
from proofs.machinery.parts import Row


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """A clock and interference, on a station of four antennas with few events; the faults are larger for it."""
    settings = replace(SETTINGS, antennas=4, events_per_year=300)
    return [close_loop(settings, 1.5, seed) for seed in (1, 4)]


def test_the_fault_is_named_and_with_it_c_is_right_again(rows: list[Row]) -> None:
    for row in rows:
        assert row["is_named"]
        assert row["moved"] > MOVED
        assert row["wrong"] < 0.5
        assert row["left"] == "consistent"
        assert row["is_plain_in_year_1"]
        assert set(row["status"]["with"]) == {"converged"}


def test_the_gain_on_the_next_year_is_what_was_promised(rows: list[Row]) -> None:
    for row in rows:
        gain, expected, sigma = row["gain"]
        assert abs(gain - expected) < 3 * sigma
        assert abs(gain - row["promise"][0]) < 3 * row["promise"][1]


def test_the_size_of_year_3_is_that_planted(rows: list[Row]) -> None:
    for row in rows:
        value, sigma = row["fitted"]
        assert abs(value - row["size"]) < 4 * sigma
        assert row["fault"] in FAULTS


def test_the_judgement_refutes_a_loop_that_does_not_close(rows: list[Row]) -> None:
    broken = [{**row, "wrong": 4.0, "left": "unexplained", "gain": [0.0, *row["gain"][1:]]} for row in rows * 10]
    verdict = {claim.key: claim.verdict for claim in judge(broken)}
    assert [verdict[key] for key in ("right", "left", "gain")] == ["refuted"] * 3
    assert len(tell([*rows, {**rows[0], "is_named": False}])) == 2 + 3
