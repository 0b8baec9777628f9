"""The second world beside the project, in small: what an investigation says where nothing is hidden."""

from pathlib import Path

import pytest

from validation.chain_form import PARTS, WORLD, draw_conditions, judge_last, judge_quiet, last, listen
from validation.machinery.records import asked_of


@pytest.mark.long
@pytest.mark.shared
def test_a_small_year_of_the_second_world_with_nothing_hidden_is_given_no_name(shared: Path) -> None:
    assert shared / "outside/world.py" == WORLD
    row = listen(3, antennas=3, events=150)
    assert (row["verdict"], row["named"], row["axis"]) == ("consistent", [], None)


@pytest.mark.long
@pytest.mark.shared
def test_days_of_the_second_world_are_as_uncertain_as_their_gains_that_last(shared: Path) -> None:
    assert shared / "outside/world.py" == WORLD
    found = judge_last([last(seed, antennas=4) for seed in (3, 4)])
    assert 0.5 < found[0].found < 1.7
    assert [one.key for one in found] == list(asked_of("chain_form", "days"))


def test_conditions_are_drawn_and_what_is_said_of_nothing_is_counted() -> None:
    drawn = [draw_conditions(seed) for seed in range(60)]
    assert {one["sky"] for one in drawn} == {"lfsm-5.1deg", "gsm-408locked"}
    hours = [one["memory_h"] for one in drawn]
    assert (0.0 <= min(hours) < 6.0, 18.0 < max(hours) <= 24.0) == (True, True)
    said = [("consistent", []), ("explained", ["rfi_line"]), ("unexplained", []), ("consistent", [])]
    found = {one.key: one for one in judge_quiet([{"verdict": verdict, "named": named} for verdict, named in said])}
    assert (found["named"].found, found["said"].found) == (0.25, 0.5)
    assert found.keys() == set(asked_of("chain_form", "quiet"))
    assert [part.name for part in PARTS] == ["front", "behind", "cover", "days", "quiet"]
