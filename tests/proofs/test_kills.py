from __future__ import annotations

import os

import pytest

from proofs._postgres import find_binaries
from proofs.kills import prove


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_three_kills_lose_nothing_and_change_nothing(kind: str) -> None:
    """The suite's small instance of `./dev prove kills`."""
    if kind == "postgresql" and not (os.environ.get("CI") or os.environ.get("LBACAL_TEST_PG") or find_binaries()):
        pytest.skip("needs PostgreSQL server binaries, or LBACAL_TEST_PG")
    holds, figures = prove([kind, "3"])
    assert holds, "\n".join(figures)
