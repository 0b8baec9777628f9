from __future__ import annotations

import pytest

from proofs.kills import prove


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_three_kills_lose_nothing_and_change_nothing(request: pytest.FixtureRequest, kind: str) -> None:
    """The suite's small instance of `./dev prove kills`."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    holds, figures = prove([kind, "3"])
    assert holds, "\n".join(figures)
