"""Records keep what was measured, and what was quoted was measured on data sets that nobody had seen."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest

from validation.machinery.claims import Asked, Found, decide, rate_of
from validation.machinery.ledger import DEBUG_BELOW, Block, Entry, first_unspent, joined, read_ledger
from validation.machinery.parts import Part, Row, parts_of, proof_names
from validation.machinery.records import Record, asked_of, path_of, read_history, read_record, read_records
from validation.machinery.trials import read_kept, run_part, run_trials


def test_a_record_is_read_as_it_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr("validation.machinery.records.RECORDS", tmp_path)
    claims = decide([rate_of("good", 9, 10)], {"good": Asked("Nine of ten are good", at_least=0.8)})
    rows = tuple({"seed": seed, "is_good": seed % 10 > 0} for seed in range(10))
    record = Record("some", "tenth", "1234567", "2027-01-01T00:00:00Z", "abc", 2, (Block(0, 10),), 0.5, claims, rows)
    path = record.write()
    assert path.name == "some-tenth.json"
    assert read_record(path) == record
    assert len(path.read_text().splitlines()) > len(record.rows)  # a trial is a line


def test_stored_records_are_what_the_ledger_and_the_claims_say():
    entries = read_ledger()
    assert len(entries) == len(set(entries))
    for record in read_records():
        name, part = record.name, parts_of(record.proof)[record.part]
        own = [one for one in entries if (one.proof, one.part) == (record.proof, record.part)]
        assert record.proof in proof_names(), name
        assert path_of(record.proof, record.part).is_file(), name
        assert all(any(one.is_held([block], {record.commit}) for one in own) for block in record.blocks), name
        assert all(block.first >= DEBUG_BELOW for block in record.blocks) == part.has_chance, name
        assert record.look <= (len(own) if part.has_chance else 1), name
        asked = {claim.key: claim.asked for claim in record.claims}
        assert set(asked) <= set(asked_of(record.proof, record.part)), name
        if record.rows:
            seeds = [seed for block in record.blocks for seed in range(block.first, block.end)]
            assert [row["seed"] for row in record.rows] == seeds, name
            assert decide(part.judge(record.rows), asked, record.look) == record.claims, name


def test_no_seed_is_in_two_results():
    blocks: dict[tuple[str, str], list[Block]] = {}
    for record in [*read_records(), *read_history()]:
        fresh = [block for block in record.blocks if block.first >= DEBUG_BELOW]
        blocks.setdefault((record.proof, record.part), []).extend(fresh)
    for own in blocks.values():
        joined(own)


def entry(first: int, count: int, commit: str = "abcdefa") -> Entry:
    return Entry("some", "part", first, count, "2027-01-01T00:00:00Z", commit)


def test_neighbours_become_one_block_and_a_seed_is_in_one_block_only():
    blocks = [Block(20, 5), Block(10, 10), Block(40, 1)]
    assert joined(blocks) == (Block(10, 15), Block(40, 1))
    with pytest.raises(ValueError, match="seeds 24 to 24 are in two blocks"):
        joined([*blocks, Block(24, 1)])


def test_the_next_seed_comes_after_all_that_were_entered_and_never_below_those_for_debugging():
    assert first_unspent([]) == DEBUG_BELOW
    assert first_unspent([entry(0, 50)]) == DEBUG_BELOW
    assert first_unspent([entry(DEBUG_BELOW + 100, 50), entry(DEBUG_BELOW, 5)]) == DEBUG_BELOW + 150


def test_seeds_are_held_by_a_record_that_has_them_and_fixed_cases_by_their_commit():
    assert entry(DEBUG_BELOW, 5).is_held([Block(DEBUG_BELOW + 4, 6)], set())
    assert not entry(DEBUG_BELOW, 5).is_held([Block(DEBUG_BELOW + 5, 6)], {"abcdefa"})
    assert entry(0, 5).is_held([], {"abcdefa"})
    assert not entry(0, 5).is_held([Block(0, 5)], {"1234567"})


DONE: list[int] = []


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
    assert sorted(run_trials(abs, range(-7, 0), "sizes", workers)) == [1, 2, 3, 4, 5, 6, 7]


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
    kept.write_text(kept.read_text()[:-9])
    DONE.clear()
    rows = run_part(NOTED, Block(1, 3), kept, workers=1)
    assert DONE == [3]
    assert [row["seed"] for row in rows] == [1, 2, 3]
    assert [json.loads(line)["seed"] for line in kept.read_text().splitlines()] == [1, 2, 3]


def test_what_is_judged_is_what_is_stored(tmp_path: Path):
    (row,) = run_part(NOTED, Block(2, 1), tmp_path / "noted.jsonl", workers=1)
    assert row["pair"] == [2, 2]
    assert row["seconds"] >= 0


@pytest.mark.parametrize("proof", proof_names())
def test_every_part_of_a_proof_can_be_sent_to_other_processes(proof: str):
    parts = parts_of(proof)
    assert parts
    for name, part in parts.items():
        assert part.name == name
        assert part.count > 0
        assert pickle.loads(pickle.dumps(part)).name == name  # noqa: S301  (our own)
