from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from validation.growth import compare
from validation.kill_adoptions import kill_and_count
from validation.kills import kill_and_compare
from validation.machinery.records import verdicts_of
from validation.troubles import TROUBLES, endure, small_disk


@pytest.fixture(params=["sqlite", "postgresql"])
def kind(request: pytest.FixtureRequest) -> str:
    """A kind of database."""
    if request.param == "postgresql":
        request.getfixturevalue("needs_postgres")
    return request.param


def test_four_kills_lose_nothing_and_change_nothing(kind: str) -> None:
    """The suite's small instance of `./dev prove kills`."""
    row = kill_and_compare(kind, kills=4, seed=0)
    assert row["broken"] == [], row
    assert row["tags"] > 0


@pytest.mark.long
def test_kills_among_dask_workers_backups_and_decisions_lose_nothing(kind: str) -> None:
    """The suite's small instance of the parts `-whole`."""
    row = kill_and_compare(kind, kills=6, seed=1, is_whole=True)
    assert row["broken"] == [], row
    assert row["decisions"] > 0


def test_480_kills_without_a_broken_promise_show_that_fewer_than_one_in_a_hundred_breaks_one() -> None:
    whole, broken = {"kills": 40, "broken": []}, {"kills": 40, "broken": ["a claim"]}
    for rows, verdict in (([whole] * 12, "shown"), ([whole] * 2, "undecided"), ([broken] * 10, "refuted")):
        assert verdicts_of("kills", "sqlite", rows) == {"broken": verdict}


def test_three_kills_leave_no_adoption_half_done(kind: str) -> None:
    """The suite's small instance of `./dev prove kill_adoptions`."""
    row = kill_and_count(kind, kills=3, seed=0)
    assert row["broken"] == []
    assert row["acts"] >= 2


def test_a_run_with_a_broken_promise_refutes() -> None:
    assert verdicts_of("kill_adoptions", "sqlite", [{"kills": 20, "broken": []}] * 24) == {"broken": "shown"}
    assert verdicts_of("kill_adoptions", "sqlite", [{"kills": 20, "broken": ["a claim"]}] * 20) == {"broken": "refuted"}


@pytest.mark.parametrize("name", TROUBLES)
def test_what_was_acknowledged_is_there_after_a_trouble(request: pytest.FixtureRequest, name: str) -> None:
    """The suite's small instance of `./dev prove troubles`."""
    if name.startswith("postgresql"):
        request.getfixturevalue("needs_postgres")
    if name.endswith("full"):
        try:
            with small_disk():
                pass
        except PermissionError as error:
            pytest.skip(f"a disk that can be full is a file system of its own, and mounting one needs root: {error}")
    row = endure(name, events=40, seed=0)
    assert (row["lost"], row["broken"]) == (0, [])
    assert row["acknowledged"] > 40


def test_one_loss_in_a_thousand_is_not_what_is_asked() -> None:
    good = {"acknowledged": 500, "lost": 0, "broken": []}
    for rows, verdict in (([good] * 10, "shown"), ([good] * 2, "undecided"), ([{**good, "lost": 4}] * 8, "refuted")):
        assert verdicts_of("troubles", "sqlite-full", rows) == {"lost": verdict}


def test_every_request_is_answered_after_one_year_and_after_two(kind: str) -> None:
    """The suite's small instance of `./dev prove growth`."""
    row = compare(kind, 0, years=2, kept=1, turns=1)
    assert all(before > 0.0 and after > 0.0 for before, after in row["ms"].values())
    assert row["megabytes"][0] < row["megabytes"][1]


def found(ms: Mapping[str, Sequence[float]]) -> dict[str, str]:
    steady = {name: [10.0, 10.0] for name in ("gap, one path", "gap, all paths", "promotion of a path")}
    row: dict[str, Any] = {"years": 10, "turns": 9, "ms": {**steady, "promotion of the array": [40.0, 40.0], **ms}}
    return verdicts_of("growth", "sqlite", [row])


def test_one_request_that_grows_refutes_the_claim() -> None:
    assert set(found({}).values()) == {"shown"}
    assert found({"jobs": [10.0, 21.0]})["ratio"] == "refuted"
    assert found({"gap, all paths": [15.0, 21.0]})["gap"] == "refuted"
    assert found({"promotion of the array": [40.0, 51.0]})["array"] == "refuted"
