from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.lstcurve.compare import BAND_MHZ, published_noise_share
from lbacal_paper.statements import (
    AGREE,
    BY_CONSTRUCTION,
    DISAGREE,
    UNDECIDED,
    UNTESTED,
    Result,
    Statement,
    describe_verdicts,
    judge,
    load_statements,
    make_claims,
    not_testable,
    round_to_error,
)


def statement(relation: str = "equal", precision: float = 1.0) -> Statement:
    return Statement("s", "1", "text", 10.0, "%", precision, relation)


@pytest.mark.parametrize(
    ("relation", "ours", "verdict"),
    [
        ("equal", 12.0, AGREE),
        ("equal", 12.5, DISAGREE),
        ("equal", 7.5, DISAGREE),
        ("at most", 1.0, AGREE),
        ("at most", 12.5, DISAGREE),
        ("at least", 30.0, AGREE),
        ("at least", 7.5, DISAGREE),
    ],
)
def test_a_verdict_follows_the_relation_and_two_standard_deviations(relation: str, ours: float, verdict: str) -> None:
    assert judge(statement(relation), Result(ours, 0.0, "")) == verdict


def test_our_error_counts_with_the_precision_of_the_statement() -> None:
    assert judge(statement(), Result(14.0, 0.0, "")) == DISAGREE
    assert judge(statement(), Result(14.0, 2.0, "")) == UNDECIDED


@pytest.mark.parametrize(("relation", "ours"), [("equal", 10.0), ("at most", 9.0), ("at least", 11.0)])
def test_an_error_above_the_precision_of_the_statement_is_no_agreement(relation: str, ours: float) -> None:
    """0.0 +- 3.5 agreed with slopes that are equal to 0.2."""
    assert judge(statement(relation), Result(ours, 0.9, "")) == AGREE
    assert judge(statement(relation), Result(ours, 1.1, "")) == UNDECIDED


def test_a_limit_that_is_kept_by_two_of_our_errors_is_kept() -> None:
    assert judge(statement("at most"), Result(4.0, 3.0, "")) == AGREE
    assert judge(statement("at least"), Result(16.0, 3.0, "")) == AGREE


def test_what_follows_by_construction_is_called_that_and_not_counted() -> None:
    result = Result(10.0, 0.0, "", is_constructed=True)
    assert judge(statement(), result) == BY_CONSTRUCTION
    (claim,) = make_claims([statement()], {"s": result})
    assert describe_verdicts([claim, claim | {"verdict": AGREE}]) == (
        "1 of 2 statements judged: 1 agree; not judged: 1 by construction"
    )


def test_what_cannot_be_tested_is_no_agreement() -> None:
    assert judge(statement(), not_testable("needs spectra")) == UNTESTED


def test_a_result_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="nan"):
        judge(statement(), Result(np.nan, 0.0, ""))


def test_every_statement_needs_a_result_and_every_result_a_statement() -> None:
    with pytest.raises(ValueError, match="'s'"):
        make_claims([statement()], {})
    with pytest.raises(ValueError, match="'t'"):
        make_claims([statement()], {"s": not_testable(""), "t": not_testable("")})


def test_a_number_is_rounded_to_two_digits_of_its_error() -> None:
    assert round_to_error(Result(12.3456, 0.123, "")) == 12.35
    assert round_to_error(Result(12.3456, 0.0, "")) == 12.35
    assert round_to_error(Result(1234.0, 56.0, "")) == 1234.0


def test_the_published_noise_share_is_that_of_the_published_terms() -> None:
    published = {one.identifier: one for one in load_statements()}["noise-share"]
    assert published.value == pytest.approx(published_noise_share(BAND_MHZ), abs=0.0005)


def test_there_are_more_than_twenty_statements_each_with_a_section() -> None:
    statements = load_statements()
    assert len(statements) >= 25
    assert all(one.section and one.text for one in statements)
