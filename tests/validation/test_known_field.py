"""A small instance of `./dev prove known_field`."""

from __future__ import annotations

import numpy as np
import pytest

from validation.known_field import calibrate_by_source, unfold_one
from validation.machinery.records import claims_of, verdicts_of


def test_coverage_of_a_reference_source_is_as_stated() -> None:
    rows = [calibrate_by_source(seed) for seed in range(300)]
    found = {claim.key: claim.found for claim in claims_of("known_field", "source", rows)}
    # 300 geometries know a rate to 0.03
    assert found["c_1"] == pytest.approx(0.68, abs=0.09)
    assert found["trend_1"] == pytest.approx(0.68, abs=0.09)
    assert found["chi2"] == pytest.approx(1.0, abs=0.06)
    boasting = [{**row, "c_1": 0.4 * row["c_1"]} for row in rows]
    assert verdicts_of("known_field", "source", boasting)["c_1"] == "refuted"


def test_coverage_of_an_unfolded_field_is_as_stated() -> None:
    rows = [unfold_one(seed) for seed in range(200)]
    found = {claim.key: claim.found for claim in claims_of("known_field", "field", rows)}
    assert found["field_1"] == pytest.approx(0.68, abs=0.09)
    assert found["field_2"] == pytest.approx(0.95, abs=0.05)
    assert found["chi2"] == pytest.approx(1.0, abs=0.05)
    assert found["same_arm"] == 0
    loud = [{**row, "chi2": 1.5 * row["chi2"]} for row in rows]
    assert verdicts_of("known_field", "field", loud)["chi2"] == "refuted"
    assert np.mean([row["is_used"] for row in rows]) > 0.8
