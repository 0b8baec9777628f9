from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from validation.growth import compare
from validation.machinery.records import claims_of


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_every_request_is_answered_after_one_year_and_after_two(request: pytest.FixtureRequest, kind: str) -> None:
    """The suite's small instance of `./dev prove growth`."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    row = compare(kind, 0, years=2, kept=1, turns=1)
    assert all(before > 0.0 and after > 0.0 for before, after in row["ms"].values())
    assert row["megabytes"][0] < row["megabytes"][1]


def found(ms: Mapping[str, Sequence[float]]) -> dict[str, str]:
    steady = {name: [10.0, 10.0] for name in ("gap, one path", "gap, all paths", "promotion of a path")}
    row: dict[str, Any] = {"years": 10, "turns": 9, "ms": {**steady, "promotion of the array": [40.0, 40.0], **ms}}
    return {claim.key: claim.verdict for claim in claims_of("growth", "sqlite", [row])}


def test_one_request_that_grows_refutes_the_claim() -> None:
    assert set(found({}).values()) == {"shown"}
    assert found({"jobs": [10.0, 21.0]})["ratio"] == "refuted"
    assert found({"gap, all paths": [15.0, 21.0]})["gap"] == "refuted"
    assert found({"promotion of the array": [40.0, 51.0]})["array"] == "refuted"
