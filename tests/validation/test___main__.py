"""`./dev prove`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from validation.__main__ import main, read_standing, standing_since
from validation.machinery.ledger import read_ledger
from validation.machinery.parts import parts_of
from validation.machinery.records import path_of, read_record


def test_without_a_name_the_proofs_and_their_parts_are_listed(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 0
    assert "twin           clean, nuisances" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["astrology"], "no proof astrology; there are "),
        (["twin", "--part", "dirty"], "twin has no part dirty; it has"),
    ],
)
def test_what_does_not_exist_is_one_sentence(arguments: list[str], why: str, capsys: pytest.CaptureFixture[str]):
    assert main([*arguments, "--scratch"]) == 2
    assert why in capsys.readouterr().err


def test_a_scratch_run_tells_claims_and_tables_and_records_nothing(capsys: pytest.CaptureFixture[str]):
    assert main(["twin", "--part", "clean", "--count", "2", "--scratch"]) == 0
    told = capsys.readouterr().out
    assert "2 trials, scratch: decides nothing" in told
    assert "undecided R.m.s. of the pulls of C of paths" in told
    assert "| trials | 2 |" in told


def test_the_standing_validation_takes_four_hours_of_one_core_at_most():
    hours = 0.0
    for proof, counts in read_standing().items():
        assert set(counts) <= set(parts_of(proof)), proof
        for part, count in counts.items():
            record = read_record(path_of(proof, part))
            hours += count * record.hours / sum(block.count for block in record.blocks)
    assert 2.0 < hours <= 4.0


def test_the_standing_validation_runs_what_has_no_result_since_a_day(monkeypatch: pytest.MonkeyPatch):
    every = {(proof, part) for proof, counts in read_standing().items() for part in counts}
    assert {(proof, part) for proof, part, _ in standing_since("9999-01-01")} == every
    assert standing_since("2000-01-01") == []
    one = read_ledger("discovery", "one")[-1]
    broken_off = replace(one, part="unknown", first=one.first + 10**9)
    monkeypatch.setattr("validation.__main__.read_ledger", lambda: [one, broken_off])
    assert {(proof, part) for proof, part, _ in standing_since(one.entered_at[:10])} == every - {("discovery", "one")}


def test_a_day_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        main(["--standing", "last week"])
    assert "argument --standing: expected a day as YYYY-MM-DD, got last week" in capsys.readouterr().err


def test_the_first_seed_of_a_recorded_run_cannot_be_chosen(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        main(["twin", "--first", "2000000"])
    assert "seeds of a recorded run follow from the ledger" in capsys.readouterr().err
