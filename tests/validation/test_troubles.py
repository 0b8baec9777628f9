from __future__ import annotations

import pytest

from validation.machinery.records import claims_of
from validation.troubles import TROUBLES, endure, small_disk


@pytest.mark.parametrize("name", TROUBLES)
def test_what_was_acknowledged_is_there_after_a_trouble(request: pytest.FixtureRequest, name: str) -> None:
    """The suite's small instance of `./dev prove troubles`."""
    if name.startswith("postgresql"):
        request.getfixturevalue("needs_postgres")
    if name.endswith("full"):
        try:
            with small_disk():
                pass
        except PermissionError as error:
            pytest.skip(f"a disk that can be full is a file system of its own, and mounting one needs root: {error}")
    row = endure(name, events=40, seed=0)
    assert (row["lost"], row["broken"]) == (0, [])
    assert row["acknowledged"] > 40


def test_one_loss_in_a_thousand_is_not_what_is_asked() -> None:
    good = {"acknowledged": 500, "lost": 0, "broken": []}
    assert claims_of("troubles", "sqlite-full", [good] * 10)[0].verdict == "shown"
    assert claims_of("troubles", "sqlite-full", [good, good])[0].verdict == "undecided"
    assert claims_of("troubles", "sqlite-full", [{**good, "lost": 4}] * 8)[0].verdict == "refuted"
