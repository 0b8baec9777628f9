from __future__ import annotations

import pytest

from lbacal_core.paper.study import Study, make_study


@pytest.fixture(scope="session")
def study() -> Study:
    """A small Superterp-year: six antennas a station."""
    return make_study(lambda _: None, antennas=6)
