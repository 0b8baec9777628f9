"""`./dev prove`."""

from __future__ import annotations

import pytest

from validation.__main__ import main


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
    assert "| antenna | 55 MHz |" in told
