"""A small instance of `./dev prove audit`."""

from __future__ import annotations

import pytest

from validation.audit import (
    KINDS,
    tell_arms,
    tell_audit,
    tell_kinds,
    tell_letters,
    tell_paths,
)
from validation.machinery.parts import Row
from validation.machinery.records import claims_of

OF_A_DAY = ("letters of one", "letters of all", "clock", "arms", "latitude", "volts")


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """Two healthy stations of 12 antennas and every kind of fault, in a day where a minute does not do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("validation.audit.SIZE_CHANCES", (1.0, 0.0, 0.0, 0.0, 0.0))
        healthy = [tell_audit("day", 0), tell_audit("minute", 2)]
        lengths = [(k, "day" if kind in OF_A_DAY else "minute") for k, kind in enumerate(KINDS)]
        return healthy + [tell_audit(length, 2 * k + 1) for k, length in lengths]


def test_every_kind_of_fault_is_named_and_nothing_in_healthy_stations(rows: list[Row]) -> None:
    assert {row["kind"] for row in rows} == {"nothing", *KINDS}
    silent = ("letters of a field", "longitude")  # what a minute does not tell
    assert [(row["kind"], row["said"]) for row in rows if row["outcome"] != "right" and row["kind"] not in silent] == []


def test_clock_and_arms_are_found_within_their_errors(rows: list[Row]) -> None:
    for row in rows:
        if "off" in row:
            assert abs(row["off"]) < 4 * row["sigma"]


def test_parts_of_one_kind_draw_this_kind_alone() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("validation.audit.SIZE_CHANCES", (1.0, 0.0, 0.0, 0.0, 0.0))
        turned, exchanged = tell_arms(5), tell_letters(5)
    assert (turned["kind"], exchanged["kind"]) == ("arms", "letters of all")
    assert {
        claim.key: claim.verdict
        for claim in claims_of("audit", "arms", [turned]) + claims_of("audit", "letters", [exchanged])
    } == dict.fromkeys(("arms", "letters"), "undecided")
    assert {turned["outcome"], exchanged["outcome"]} == {"right"}


def test_the_part_of_paths_takes_lengths_and_kinds_in_turn() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("validation.audit.SIZE_CHANCES", (1.0, 0.0, 0.0, 0.0, 0.0))
        rows = [tell_paths(seed) for seed in (2, 5)]
    assert [(row["length"], row["kind"], row["outcome"]) for row in rows] == [
        ("minute", "dead", "right"),
        ("minute", "deaf", "right"),
    ]
    assert [
        (claim.key, claim.verdict) for claim in claims_of("audit", "paths", [*rows, tell_paths(0), tell_paths(1)])
    ] == [(length, "undecided") for length in ("day", "hour", "minute")]


def test_a_minute_names_no_clock_and_still_finds_a_dead_path() -> None:
    said = [tell_audit("minute", seed) for seed in (1, 19, 21)]  # dead, clock, arms
    assert [row["outcome"] for row in said] == ["right", "silent", "silent"]
    assert {claim.verdict for claim in claims_of("audit", "minute", said)} == {"undecided"}


def test_the_judgement_refutes_an_audit_that_names_healthy_stations(rows: list[Row]) -> None:
    rash = [row | {"outcome": "false"} if row["kind"] == "nothing" else row for row in rows]
    assert {claim.key: claim.verdict for claim in claims_of("audit", "day", rash)}["false"] == "refuted"
    assert len(tell_kinds(rows)) == 2 + 1 + len(KINDS)
