from __future__ import annotations

import numpy as np
import pytest

import lbacal
from lbacal.client import make_table
from lbacal.voltages import curve_of
from lbacal_core.errors import BadInputError

CHANNELS = [30.0, 31.0, 32.0]


def answer(**changes: object) -> dict[str, object]:
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


def test_unknown_errors_are_not_taken_for_zero_errors() -> None:
    curve = curve_of(make_table(answer()))
    assert curve.c_sigma_sys is None
    assert curve.name == "CS002 antenna 17 X"


def test_rows_of_two_paths_are_refused() -> None:
    both = answer()
    both["curves"] = [*both["curves"], *answer(dipole="Y")["curves"]]  # type: ignore[misc]
    with pytest.raises(BadInputError, match="2 paths"):
        curve_of(make_table(both))
