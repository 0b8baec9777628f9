"""A small instance of `./dev prove audit`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from validation.audit import KINDS, PARTS, PATHS, RECORD, tell_audit, tell_fault, tell_paths, tell_unlike
from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of

OF_A_DAY = ("letters of one", "letters of all", "clock", "arms", "latitude", "volts")


@pytest.fixture(scope="module", autouse=True)
def few_antennas() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("validation.audit.SIZE_CHANCES", (1.0, 0.0, 0.0, 0.0, 0.0))
        yield


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """Two healthy stations of 12 antennas and every kind of fault, in a day where a minute does not do."""
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
    turned, exchanged = ({part.name: part for part in PARTS}[name].trial(5) for name in ("arms", "letters"))
    assert (turned["kind"], exchanged["kind"]) == ("arms", "letters of all")
    assert verdicts_of("audit", "arms", [turned]) == {"arms": "undecided"}
    assert verdicts_of("audit", "letters", [exchanged]) == {"letters": "undecided"}
    assert {turned["outcome"], exchanged["outcome"]} == {"right"}


def test_the_part_of_paths_takes_lengths_and_kinds_in_turn() -> None:
    day, hour, *rows = (tell_paths(seed) for seed in (0, 1, 2, 5))
    told = [(row["length"], row["kind"], row["outcome"]) for row in rows]
    assert told == [("minute", "dead", "right"), ("minute", "deaf", "right")]
    found = verdicts_of("audit", "paths", [*rows, day, hour])
    assert list(found.items()) == [(length, "undecided") for length in ("day", "hour", "minute")]


def test_a_minute_names_no_clock_and_still_finds_a_dead_path() -> None:
    said = [tell_audit("minute", seed) for seed in (1, 19, 21)]  # dead, clock, arms
    assert [row["outcome"] for row in said] == ["right", "silent", "silent"]
    assert set(verdicts_of("audit", "minute", said).values()) == {"undecided"}


def test_the_judgement_refutes_an_audit_that_names_healthy_stations(rows: list[Row]) -> None:
    rash = [row | {"outcome": "false"} if row["kind"] == "nothing" else row for row in rows]
    assert verdicts_of("audit", "day", rash)["false"] == "refuted"


@pytest.mark.parametrize("seed", [5000, 5005, 5010])
def test_a_healthy_station_of_antennas_as_unlike_as_the_worst_measured_is_left_alone(seed: int) -> None:
    """Of 12 antennas that differ by 17 %, two were said to oscillate or to lie outside in the second of them."""
    assert tell_fault("day", seed, "nothing", 0.17)["said"] == []
    broken = tell_fault("day", seed, "oscillating", 0.17)
    assert broken["outcome"] == "right", broken["said"]


def test_the_parts_of_unlike_antennas_count_by_their_size() -> None:
    healthy = [tell_unlike("minute", ("nothing",), seed) for seed in range(4)]
    assert [(row["kind"], row["unlike"]) for row in healthy] == [("nothing", size) for size in (0.0, 0.05, 0.1, 0.17)]
    rash = [*healthy[:3], healthy[3] | {"said": ["antenna 1 X oscillates"]}] * 20
    found = verdicts_of("audit", "unlike", rash)
    assert [found[key] for key in ("false_17", "false_0")] == ["refuted", "undecided"]
    off = [tell_unlike("day", RECORD, seed) for seed in (15, 7, 11)]
    assert [(row["kind"], row["outcome"]) for row in off] == [(k, "right") for k in ("clock", "latitude", "longitude")]
    found = verdicts_of("audit", "unlike-record", [*off, off[0] | {"unlike": 0.0, "off": 30.0}] * 200)
    assert [found[key] for key in ("error_17", "record_17", "error_0")] == ["shown", "shown", "refuted"]
    broken = [tell_unlike("minute", PATHS, seed) for seed in (3, 7)]
    assert [(row["kind"], row["unlike"], row["outcome"]) for row in broken] == [
        ("dead", 0.17, "right"), ("deaf", 0.17, "right"),
    ]  # fmt: skip
