"""Statements of the paper, what this project finds for each, and the rule that turns both into a verdict.

The statements are facts with their citation (statements.toml). What stands beside them is computed when the
command runs; no number of ours is stored.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

AGREE = "agree"
DISAGREE = "disagree"
UNDECIDED = "undecided"
UNTESTED = "cannot be tested here"
BY_CONSTRUCTION = "by construction"
VERDICTS = (AGREE, DISAGREE, UNDECIDED, UNTESTED, BY_CONSTRUCTION)
JUDGED = (AGREE, DISAGREE, UNDECIDED)
EQUAL, AT_MOST, AT_LEAST = "equal", "at most", "at least"
RELATIONS = (EQUAL, AT_MOST, AT_LEAST)
LARGEST_PULL = 2.0
"""A statement farther from ours than so many standard deviations, of the precision with which it is made and our error,
is contradicted; a nearer one agrees if our error is below that precision, or if a limit is kept by as many of our own.
"""


@dataclass(frozen=True)
class Statement:
    """One quantitative statement of the paper.

    Attributes
    ----------
    value, unit
        The published number.
    precision
        Half of its last digit, or what "on the order of" leaves open: one standard deviation, in `unit`.
    relation
        One of `RELATIONS`: how the paper states the number.
    """

    identifier: str
    section: str
    text: str
    value: float
    unit: str
    precision: float
    relation: str = EQUAL

    def __post_init__(self) -> None:
        if self.relation not in RELATIONS or not self.precision >= 0:
            raise ValueError(f"statement {self.identifier}: relation {self.relation!r}, precision {self.precision}")


@dataclass(frozen=True)
class Result:
    """The result of this project on one statement.

    Attributes
    ----------
    ours, sigma
        Our number in the unit of the statement and its standard deviation; `ours` None where it cannot be tested here.
    how
        How it was computed, from what; where it cannot be tested, exactly which data are missing.
    is_constructed
        Whether it follows by arithmetic alone, or from data drawn with the published numbers: no test of nature.
    """

    ours: float | None
    sigma: float
    how: str
    is_constructed: bool = False


def not_testable(how: str) -> Result:
    """The result for a statement about data that nobody has published."""
    return Result(None, 0.0, how)


def judge(statement: Statement, result: Result) -> str:
    """Compare a result with a statement: one of `VERDICTS`."""
    if result.ours is None:
        return UNTESTED
    if not (math.isfinite(result.ours) and math.isfinite(result.sigma)):
        raise ValueError(f"statement {statement.identifier}: {result.ours} +- {result.sigma}")
    if result.is_constructed:
        return BY_CONSTRUCTION
    excess = result.ours - statement.value
    distance = {EQUAL: abs(excess), AT_MOST: excess, AT_LEAST: -excess}[statement.relation]
    if distance > LARGEST_PULL * math.hypot(statement.precision, result.sigma):
        return DISAGREE
    is_kept = statement.relation != EQUAL and -distance >= LARGEST_PULL * result.sigma
    return AGREE if is_kept or result.sigma <= statement.precision else UNDECIDED


def make_claims(statements: Iterable[Statement], results: Mapping[str, Result]) -> list[dict[str, Any]]:
    """The content of claims.json: every statement has a result and every result a statement."""
    known = {statement.identifier: statement for statement in statements}
    if set(known) != set(results):
        raise ValueError(f"statements and results differ: {sorted(set(known) ^ set(results))}")
    return [
        {
            "id": name,
            "claim": one.text,
            "section": one.section,
            "published": one.value,
            "relation": one.relation,
            "precision": one.precision,
            "unit": one.unit,
            "ours": None if results[name].ours is None else round_to_error(results[name]),
            "sigma": None if results[name].ours is None else float(f"{results[name].sigma:.2g}"),
            "verdict": judge(one, results[name]),
            "how": results[name].how,
        }
        for name, one in known.items()
    ]


def round_to_error(result: Result) -> float:
    """Our number with two digits of its error, or four digits where it has none."""
    if result.ours is None:
        raise ValueError("there is no number of ours")
    if result.sigma <= 0:
        return float(f"{result.ours:.4g}")
    return round(result.ours, 1 - math.floor(math.log10(result.sigma)))


def describe_verdicts(claims: Sequence[Mapping[str, Any]]) -> str:
    """How many of the statements are judged, with what verdict, and what the others are, in one phrase."""
    verdicts = [claim["verdict"] for claim in claims]

    def count(kinds: Sequence[str]) -> str:
        return ", ".join(f"{verdicts.count(kind)} {kind}" for kind in kinds if kind in verdicts)

    judged, others = count(JUDGED), count([kind for kind in VERDICTS if kind not in JUDGED])
    return (
        f"{sum(one in JUDGED for one in verdicts)} of {len(claims)} statements judged: {judged}; not judged: {others}"
    )


def load_statements() -> tuple[Statement, ...]:
    """Every statement that is judged, in the order of the paper."""
    text = (files("lbacal_paper") / "statements.toml").read_text(encoding="utf-8")
    content = tomllib.loads(text)
    return tuple(Statement(identifier=name, **one) for name, one in content.items())
