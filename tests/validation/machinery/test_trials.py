from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from validation.machinery.claims import Found, rate_of
from validation.machinery.ledger import Block
from validation.machinery.parts import Part, Row
from validation.machinery.trials import read_kept, run_part, run_trials

DONE: list[int] = []


def _square(number: int) -> int:
    return number * number


def _note(seed: int) -> Row:
    DONE.append(seed)
    if seed == 13:
        raise KeyboardInterrupt
    return {"square": seed * seed, "pair": (seed, seed)}


def _judge(rows: Sequence[Row]) -> list[Found]:
    return [rate_of("any", len(rows), len(rows))]


NOTED = Part("noted", _note, _judge, 5)


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_is_done_once_however_many_processes_do_it(workers: int):
    assert sorted(run_trials(_square, range(7), "squares", workers)) == [0, 1, 4, 9, 16, 25, 36]


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path):
    kept = tmp_path / "noted.jsonl"
    DONE.clear()
    with pytest.raises(KeyboardInterrupt):
        run_part(NOTED, Block(10, 5), kept, workers=1)
    assert sorted(read_kept(kept)) == [10, 11, 12]
    DONE.clear()
    rows = run_part(NOTED, Block(10, 3), kept, workers=1)
    assert DONE == []
    assert [row["square"] for row in rows] == [100, 121, 144]


def test_a_row_that_was_cut_off_is_done_again(tmp_path: Path):
    kept = tmp_path / "noted.jsonl"
    run_part(NOTED, Block(1, 3), kept, workers=1)
    text = kept.read_text()
    kept.write_text(text[:-9])
    DONE.clear()
    rows = run_part(NOTED, Block(1, 3), kept, workers=1)
    assert DONE == [3]
    assert [row["seed"] for row in rows] == [1, 2, 3]
    assert [json.loads(line)["seed"] for line in kept.read_text().splitlines()] == [1, 2, 3]


def test_what_is_judged_is_what_is_stored(tmp_path: Path):
    (row,) = run_part(NOTED, Block(2, 1), tmp_path / "noted.jsonl", workers=1)
    assert row["pair"] == [2, 2]
    assert row["seconds"] >= 0
