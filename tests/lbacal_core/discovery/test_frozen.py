"""The numbers of whole investigations: what moves one of them is said, or is a fault."""

from __future__ import annotations

import pytest

from validation.frozen.__main__ import compare_with_stored
from validation.frozen.listing import DATA_SETS
from validation.frozen.surface import frozen_numbers

QUICK = ("gain_step", "cable_length", "curve-exchanged-late")
"""A cause among many templates, one of single antennas, and an LST curve."""
SLOW = ("cable_reflection", "clean-nuisances", "compression")


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(one, marks=pytest.mark.long) for one in SLOW)])
def test_discovery_gives_the_frozen_report_and_scores(name: str) -> None:
    assert [str(one) for one in compare_with_stored(name, frozen_numbers(DATA_SETS[name]))] == []
