from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.curves.curves import (
    CONVERGED,
    STATUSES,
    TOO_FEW_EVENTS,
    CalibrationCurve,
    FitReport,
    Parameter,
    parse_curve,
    write_fit_report,
)
from lbacal_core.provenance import Provenance

FREQUENCY = np.array([30.0, 31.0, 32.0])
GOOD = CalibrationCurve(
    station="CS002",
    antenna=17,
    dipole="X",
    status=CONVERGED,
    events=900,
    frequency_mhz=FREQUENCY,
    c=np.array([1.0, 2.0, 3.0]) / 7,
    c_sigma_stat=np.array([0.01, 0.02, 0.03]),
    c_sigma_sys=None,
    chi2_per_dof=1.1,
    lst_coverage=0.9,
    parameters={"n_lna": Parameter(0.5, 0.01), "n_rcu": Parameter(0.1, 0.002), "n_adc": Parameter(0.01, 0.001)},
)
HOLED = replace(
    GOOD,
    c=np.array([1.0, np.nan, 3.0]),
    c_sigma_stat=np.array([0.1, np.nan, 0.3]),
    flag=("ok", "outside", "uncertain"),
)
FAILED = replace(
    GOOD, antenna=3, status=TOO_FEW_EVENTS, c=None, c_sigma_stat=None, chi2_per_dof=None, events=5, parameters={}
)
STATION = replace(GOOD, antenna=None, c_sigma_sys=np.full(3, 0.1))
REPORT = FitReport((GOOD, FAILED, STATION), Provenance({"spectra": "ab"}))


@pytest.mark.parametrize("curve", [GOOD, FAILED, STATION, HOLED])
def test_a_curve_returns_from_json_bit_by_bit(curve: CalibrationCurve) -> None:
    content = json.loads(json.dumps(curve.as_dict(), allow_nan=False))
    assert parse_curve(content).as_dict() == curve.as_dict()


@pytest.mark.parametrize(
    "change",
    [
        {"status": "fine"},
        {"status": TOO_FEW_EVENTS},
        {"c": None},
        {"c": np.array([1.0, np.nan, 2.0])},
        {"c": np.array([1.0, 2.0])},
        {"c_sigma_stat": np.array([0.1, 0.0, 0.1])},
        {"c_sigma_sys": np.array([0.1, -1.0, 0.1])},
        {"flag": ("ok", "outside", "ok")},
        {"flag": ("ok", "ok")},
        {"flag": ("ok", "ok", "fine")},
    ],
)
def test_a_curve_refuses_values_that_contradict_its_status_or_its_channels(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"status|values|finite|channels"):
        replace(GOOD, **change)


def test_a_channel_outside_has_no_value_and_json_says_null() -> None:
    content = HOLED.as_dict()
    assert content["c"] == [1.0, None, 3.0]
    assert content["flag"] == ["ok", "outside", "uncertain"]
    assert HOLED.c is not None
    assert HOLED.filled(HOLED.c).tolist() == [1.0, 2.0, 3.0]


def test_a_curve_from_before_flags_keeps_its_content() -> None:
    assert "flag" not in GOOD.as_dict()
    assert GOOD.flags.tolist() == ["ok"] * 3


def test_c_over_h_does_not_depend_on_g_ant() -> None:
    # C^2 = G_ant / s: what a fit determines is s, so C/|H| is its root whatever G_ant was
    slope = np.array([4.0, 9.0, 16.0])
    for gain in (np.ones(3), np.array([3.5, 310.0, 19.0])):
        curve = replace(GOOD, c=np.sqrt(gain / slope), antenna_gain=gain)
        np.testing.assert_allclose(curve.c_over_h, slope**-0.5, rtol=1e-15)
    assert replace(FAILED, antenna_gain=np.ones(3)).c_over_h is None


def test_g_ant_has_one_hash_for_the_same_numbers_and_another_for_others() -> None:
    one, same, other = (replace(GOOD, antenna_gain=np.full(3, value)) for value in (2.0, 2.0, 2.1))
    assert one.antenna_gain_sha256 == same.antenna_gain_sha256 != other.antenna_gain_sha256
    assert one.as_dict()["antenna_gain_sha256"] == one.antenna_gain_sha256
    assert parse_curve(one.as_dict()).as_dict() == one.as_dict()


def test_the_payload_of_a_version_made_before_g_ant_was_kept_is_what_it_was() -> None:
    # payload_sha256 is the hash of these values: a null more, and every pinned answer would change
    assert not {"antenna_gain", "antenna_gain_sha256", "c_over_h"} & set(GOOD.as_dict())


def test_a_curve_is_named_as_people_name_it() -> None:
    assert GOOD.name == "CS002 antenna 17 X"
    assert STATION.name == "CS002 X"
    assert replace(STATION, station=None, dipole=None).name == "array"


def test_the_status_of_a_report_is_that_of_its_worst_curve() -> None:
    assert REPORT.status == TOO_FEW_EVENTS
    assert replace(REPORT, curves=(GOOD, STATION)).status == CONVERGED
    assert STATUSES[0] == CONVERGED


def test_the_report_file_holds_every_curve_and_no_nan(tmp_path: Path) -> None:
    write_fit_report(REPORT, tmp_path / "fit.json")
    text = (tmp_path / "fit.json").read_text()
    assert "NaN" not in text
    content = json.loads(text)
    assert content["status"] == TOO_FEW_EVENTS
    assert [curve["status"] for curve in content["curves"]] == [CONVERGED, TOO_FEW_EVENTS, CONVERGED]
    assert content["curves"][1]["c"] is None
    assert content["curves"][0]["parameters"]["n_lna"] == {"value": 0.5, "sigma": 0.01}
    assert content["provenance"]["inputs"] == {"spectra": "ab"}
