from __future__ import annotations

import pytest

from validation.kill_adoptions import kill_and_count
from validation.machinery.records import claims_of


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_three_kills_leave_no_adoption_half_done(request: pytest.FixtureRequest, kind: str) -> None:
    """The suite's small instance of `./dev prove kill_adoptions`."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    row = kill_and_count(kind, kills=3, seed=0)
    assert row["broken"] == []
    assert row["acts"] >= 2


def test_a_run_with_a_broken_promise_refutes() -> None:
    whole = [{"kills": 20, "broken": []} for _ in range(24)]
    assert claims_of("kill_adoptions", "sqlite", whole)[0].verdict == "shown"
    assert (
        claims_of("kill_adoptions", "sqlite", [{"kills": 20, "broken": ["a claim"]} for _ in range(20)])[0].verdict
        == "refuted"
    )
