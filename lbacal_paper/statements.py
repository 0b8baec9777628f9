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
UNTESTED = "cannot be tested here"
VERDICTS = (AGREE, DISAGREE, UNTESTED)
EQUAL, AT_MOST, AT_LEAST = "equal", "at most", "at least"
RELATIONS = (EQUAL, AT_MOST, AT_LEAST)
LARGEST_PULL = 2.0
"""A statement counts as agreeing within two standard deviations of the precision with which it is made and our
error."""


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
    """What this project finds about one statement.

    Attributes
    ----------
    ours, sigma
        Our number in the unit of the statement and its standard deviation; `ours` None where it cannot be tested here.
    how
        How it was computed, from what; where it cannot be tested, exactly which data are missing.
    """

    ours: float | None
    sigma: float
    how: str


def not_testable(how: str) -> Result:
    """The result for a statement about data that nobody has published."""
    return Result(None, 0.0, how)


def judge(statement: Statement, result: Result) -> str:
    """Compare a result with a statement: one of `VERDICTS`."""
    if result.ours is None:
        return UNTESTED
    if not (math.isfinite(result.ours) and math.isfinite(result.sigma)):
        raise ValueError(f"statement {statement.identifier}: {result.ours} +- {result.sigma}")
    excess = result.ours - statement.value
    distance = {EQUAL: abs(excess), AT_MOST: excess, AT_LEAST: -excess}[statement.relation]
    return AGREE if distance <= LARGEST_PULL * math.hypot(statement.precision, result.sigma) else DISAGREE


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
    """How many statements agree, disagree and cannot be tested, in one phrase."""
    verdicts = [claim["verdict"] for claim in claims]
    counted = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
    return f"{len(claims)} statements: {counted}"


def load_statements() -> tuple[Statement, ...]:
    """Every statement that is judged, in the order of the paper."""
    text = (files("lbacal_paper") / "statements.toml").read_text(encoding="utf-8")
    content = tomllib.loads(text)
    return tuple(Statement(identifier=name, **one) for name, one in content.items())
