from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_paper.budget import Budget
from lbacal_paper.calibration_results import find_about_calibration
from lbacal_paper.statements import AGREE, BY_CONSTRUCTION, UNDECIDED, Result, judge, load_statements
from lbacal_paper.study import Study


@pytest.fixture(scope="module")
def results(study: Study, budget: Budget) -> dict[str, Result]:
    return find_about_calibration(study, budget, None)


def test_what_hangs_on_event_spectra_says_so(results: dict[str, Result]) -> None:
    for name in ("event-fluctuation", "yearly-scatter", "no-trend"):
        assert results[name].ours is None
        assert "background spectra" in results[name].how


def test_table_1_follows_for_the_sky_and_in_total(results: dict[str, Result]) -> None:
    statements = {one.identifier: one for one in load_statements()}
    for name in ("sky-quadrature", "table-sky", "table-total"):
        assert judge(statements[name], results[name]) == BY_CONSTRUCTION
        assert judge(statements[name], replace(results[name], is_constructed=False)) == AGREE


def test_what_the_weights_or_the_edge_decide_is_undecided(results: dict[str, Result]) -> None:
    statements = {one.identifier: one for one in load_statements()}
    for name in ("table-antenna", "pattern-limit"):
        assert judge(statements[name], results[name]) == UNDECIDED
    assert "% with weights without event gain" in results["table-antenna"].how


def test_the_limit_of_the_pattern_contains_no_change_or_its_neighbourhood(results: dict[str, Result]) -> None:
    limit = results["pattern-limit"].ours
    assert limit is not None
    assert 2.0 < limit < 15.0


def test_the_spread_of_gain_tables_is_measured(study: Study, budget: Budget, tmp_path: Path) -> None:
    (tmp_path / "caltables").mkdir()
    rng = np.random.default_rng(1)
    for station in (2, 3):
        gains = np.exp(rng.normal(0, 0.05, 96))[None, :] * np.ones((512, 1)) + 0j
        (tmp_path / f"caltables/CalTable_00{station}_mode1.dat").write_bytes(gains.astype("<c16").tobytes())
    found = find_about_calibration(study, budget, tmp_path)["table-electronics"]
    assert found.ours == pytest.approx(5.0, abs=1.2)


@pytest.mark.shared
def test_the_measured_gain_tables_agree_with_the_paper(study: Study, budget: Budget, shared: Path) -> None:
    found = find_about_calibration(study, budget, shared / "data")["table-electronics"]
    assert found.ours is not None
    assert 2.0 < found.ours < 6.5
