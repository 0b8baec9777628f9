from __future__ import annotations

import pytest

from validation.kills import kill_and_compare
from validation.machinery.records import claims_of


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_four_kills_lose_nothing_and_change_nothing(request: pytest.FixtureRequest, kind: str) -> None:
    """The suite's small instance of `./dev prove kills`."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    row = kill_and_compare(kind, kills=4, seed=0)
    assert row["broken"] == [], row
    assert row["tags"] > 0


def test_480_kills_without_a_broken_promise_show_that_fewer_than_one_in_a_hundred_breaks_one() -> None:
    runs = [{"kills": 40, "broken": []} for _ in range(12)]
    assert claims_of("kills", "sqlite", runs)[0].verdict == "shown"
    assert claims_of("kills", "sqlite", runs[:2])[0].verdict == "undecided"
    broken = [{"kills": 40, "broken": ["a claim"]} for _ in range(10)]
    assert claims_of("kills", "sqlite", broken)[0].verdict == "refuted"
