from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lbacal
from lbacal.client import make_table
from lbacal.voltages import curve_of
from lbacal_core.errors import BadInputError

CHANNELS = [30.0, 31.0, 32.0]


def answer(**changes: object) -> dict[str, Any]:
    curve = {
        "station": "CS002", "antenna": 17, "dipole": "X", "frequency_mhz": CHANNELS, "c": [1e-5, 2e-5, 3e-5],
        "c_sigma_stat": [1e-7, 2e-7, 3e-7], "c_sigma_sys": None, "factor": [1.0] * 3, "flag": ["ok"] * 3,
        "flag_reason": None, "calibration": "abc", "answered_by": "antenna", "valid": {"from": "2014", "to": None},
    } | changes  # fmt: skip
    return {"curves": [curve], "at": "2014-05-01", "as_of": None, "missing": []}


def test_a_trace_is_calibrated_with_what_effective_answers() -> None:
    time = np.arange(2000) / 200.0
    found = lbacal.calibrate_trace(np.cos(2 * np.pi * 31.0 * time), 200.0, make_table(answer()))
    assert found.samples == pytest.approx(2e-5 * np.cos(2 * np.pi * 31.0 * time), abs=1e-12)
    inside = found.is_inside
    assert found.c_sigma[inside] == pytest.approx(0.01 * found.c[inside])


def test_the_covariance_of_one_path_is_found_among_the_rows_of_many() -> None:
    def covariance(size: float) -> dict[str, object]:
        statistical = {"factor": [[0.0, 0.0, 0.0]], "diagonal": [1e-4] * 3}
        return {"statistical": statistical, "systematic": {"budget": "b", "own": [[size, 0.0, -size]]}}

    term = {"name": "level", "source": "a test", "is_of_gain": False, "vectors": {"X": [[0.1, 0.1, 0.1]]}}
    many = answer(covariance=covariance(0.05))
    many["curves"] = [*answer(antenna=16, covariance=covariance(9.0))["curves"], *many["curves"]]
    many["budgets"] = {"b": {"frequency_mhz": CHANNELS, "terms": [term]}}
    table = make_table(many)
    found = lbacal.calibrate_trace(np.ones(2000), 200.0, table[table["antenna"] == 17])
    (low,), (high,) = (np.flatnonzero(found.frequency_mhz == mhz) for mhz in (30.0, 32.0))
    assert found.factors[:, low] @ found.factors[:, high] == pytest.approx(0.1**2 - 0.05**2)


def test_unknown_errors_are_not_taken_for_zero_errors() -> None:
    curve = curve_of(make_table(answer()))
    assert curve.c_sigma_sys is None
    assert curve.name == "CS002 antenna 17 X"


def test_rows_of_two_paths_are_refused() -> None:
    both = answer()
    both["curves"] = [*both["curves"], *answer(dipole="Y")["curves"]]
    with pytest.raises(BadInputError, match="2 paths"):
        curve_of(make_table(both))


def test_the_covariance_that_the_service_sends_reaches_the_trace() -> None:
    covariance = {
        "statistical": {"factor": [[0.01, 0.01, 0.01]], "diagonal": [0.0, 0.0, 0.0]},
        "systematic": {"budget": "b1", "own": []},
    }
    table = make_table(answer(covariance=covariance, c_sigma_sys=[1e-6, 2e-6, 3e-6]) | {"budgets": {}})
    curve = curve_of(table)
    assert curve.covariance is not None
    assert curve.covariance.factor.tolist() == [[0.01] * 3]
    # without the budget the systematic error is one number for all channels
    found = lbacal.calibrate_trace(np.random.default_rng(1).normal(size=2000), 200.0, table)
    assert found.errors == pytest.approx(np.array([[0.01] * 3, [0.1] * 3]))
