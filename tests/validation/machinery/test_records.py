"""Records keep what was measured, and what was quoted was measured on data sets that nobody had seen."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import pytest

from validation.machinery.claims import at_least, claim_rate
from validation.machinery.code import digest
from validation.machinery.parts import Part, Row, parts_of, proof_names
from validation.machinery.records import (
    FRESH,
    LOOKED_AT,
    RECORDS,
    REPETITION,
    Record,
    make_claims,
    newest,
    pool,
    read_record,
    read_records,
)
from validation.machinery.seeds import Block, looked_at

STORED = read_records()


def _try(seed: int) -> Row:
    return {"is_good": seed % 10 > 0}


def _judge(rows):
    return [claim_rate("good", "Nine of ten are good", at_least(0.8), sum(row["is_good"] for row in rows), len(rows))]


PART = Part("tenth", _try, _judge, 100)


def make(
    first: int, count: int, *, code: str = "abc", seeds: str = FRESH, made_at: str = "2027-01-01T00:00:00Z"
) -> Record:
    rows = tuple({"seed": seed, **_try(seed), "seconds": 36.0} for seed in range(first, first + count))
    claims = make_claims(PART, rows, seeds)
    return Record("some", "tenth", "1234567", made_at, code, (Block(first, count),), seeds, count / 100, claims, rows)


def test_a_record_is_read_as_it_was_written(tmp_path):
    record = make(1_000_000, 30)
    path = record.write(tmp_path)
    assert path.name == "some-tenth-1234567.json"
    assert read_record(path) == record
    assert len(path.read_text().splitlines()) > len(record.rows)  # a trial is a line


def test_records_of_the_same_code_are_pooled_and_hours_summed():
    one, other = make(1_000_000, 100), make(1_000_100, 300)
    whole = pool([other, one], PART)
    assert whole.blocks == (Block(1_000_000, 400),)
    assert whole.hours == pytest.approx(4.0)
    assert [row["seed"] for row in whole.rows] == list(range(1_000_000, 1_000_400))
    assert whole.claim("good").n == 400
    assert whole.commands == ("./dev prove some --part tenth --first 1000000 --count 400",)


def test_every_block_of_a_record_has_its_command():
    whole = pool([make(1_000_000, 100), make(1_000_200, 30)], PART)
    assert whole.commands == (
        "./dev prove some --part tenth --first 1000000 --count 100",
        "./dev prove some --part tenth --first 1000200 --count 30",
    )


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (make(1_000_100, 10, code="def"), "different code"),
        (make(1_000_050, 60), "in two records"),
        (make(1_000_100, 10, seeds=REPETITION), "with fresh and with other seeds"),
    ],
)
def test_what_does_not_belong_together_is_not_pooled(other, why):
    with pytest.raises(ValueError, match=why):
        pool([make(1_000_000, 100), other], PART)


def test_records_without_a_digest_are_not_pooled():
    with pytest.raises(ValueError, match="different code"):
        pool([make(0, 10, code=""), make(10, 10, code="")], PART)


def test_repeated_seeds_decide_nothing():
    assert make(1_000_000, 1000).claim("good").verdict == "shown"
    assert make(1_000_000, 1000, seeds=REPETITION).claim("good").verdict == "undecided"


def test_the_newest_record_counts():
    old, new = make(1_000_000, 10), make(1_000_010, 10, made_at="2027-02-01T00:00:00Z")
    assert newest([new, old])["some", "tenth"] == new


def test_a_repetition_does_not_take_the_place_of_a_record_with_fresh_seeds():
    fresh, again = make(1_000_000, 10), make(1_000_000, 10, seeds=REPETITION, made_at="2027-02-01T00:00:00Z")
    assert newest([fresh, again])["some", "tenth"] == fresh
    assert fresh.file_name != again.file_name


@pytest.mark.parametrize("record", STORED, ids=lambda record: record.file_name)
class TestStored:
    def test_it_is_named_after_what_it_holds(self, record: Record):
        assert (RECORDS / record.file_name).is_file()
        assert record.proof in proof_names()
        assert record.part in parts_of(record.proof)

    def test_its_claims_are_what_its_trials_show(self, record: Record):
        part = parts_of(record.proof)[record.part]
        if record.code != digest(part.trial, part.code):
            pytest.skip("judged by other code than today's")
        assert make_claims(part, record.rows, record.seeds) == record.claims

    def test_every_seed_is_a_row(self, record: Record):
        if not record.code:
            assert record.remark, "a record without trials says where it comes from"
            return
        seeds = [seed for block in record.blocks for seed in range(block.first, block.end)]
        assert [row["seed"] for row in record.rows] == seeds
        assert record.hours > 0

    def test_fresh_seeds_were_fresh(self, record: Record):
        if record.seeds != FRESH:
            assert record.seeds == "no chance" or not any(claim.is_fresh for claim in record.claims)
            return
        assert not any(block.is_for_debugging for block in record.blocks)
        seen = looked_at(LOOKED_AT, record.proof, record.part)
        assert not any(block.overlaps(other) for block in record.blocks for other in seen)


def test_no_two_records_with_fresh_seeds_share_one():
    fresh = [record for record in STORED if record.seeds == FRESH]
    for one, other in combinations(fresh, 2):
        if (one.proof, one.part) == (other.proof, other.part):
            shared = [(a, b) for a in one.blocks for b in other.blocks if a.overlaps(b)]
            assert shared == [], (one.file_name, other.file_name)


def test_replacing_a_commit_replaces_the_file_name():
    assert replace(make(1_000_000, 1), commit="fedcba9").file_name == "some-tenth-fedcba9.json"
