from __future__ import annotations

import pytest

from lbacal_paper.budget import Budget, compute_budget
from lbacal_paper.shower_study import ShowerStudy, study_showers
from lbacal_paper.study import Study, make_study


@pytest.fixture(scope="session")
def study() -> Study:
    """A small Superterp-year: six antennas a station."""
    return make_study(lambda _: None, antennas=6)


@pytest.fixture(scope="session")
def budget(study: Study) -> Budget:
    return compute_budget(study)


@pytest.fixture(scope="session")
def showers(study: Study, budget: Budget) -> ShowerStudy:
    """1653 stand-in signals with every calibration."""
    return study_showers(study, budget)
