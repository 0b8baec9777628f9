import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
)
from lbacal_core.curves.galcal import FORMAT, describe_made_with, find_problems, make_head
from lbacal_core.instrument.instrument import load_instrument
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
    GOOD, c=np.array([1.0, np.nan, 3.0]), c_sigma_stat=np.array([0.1, np.nan, 0.3]), flag=("ok", "outside", "uncertain")
)
FAILED = replace(
    GOOD, antenna=3, status=TOO_FEW_EVENTS, c=None, c_sigma_stat=None, chi2_per_dof=None, events=5, parameters={}
)
STATION = replace(GOOD, antenna=None, c_sigma_sys=np.full(3, 0.1))
REPORT = FitReport((GOOD, FAILED, STATION), Provenance({"spectra": "ab"}))


@pytest.mark.parametrize("curve", [GOOD, FAILED, STATION, HOLED])
def test_a_curve_returns_from_json_bit_by_bit(curve):
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
def test_a_curve_refuses_values_that_contradict_its_status_or_its_channels(change):
    with pytest.raises(ValueError, match=r"status|values|finite|channels"):
        replace(GOOD, **change)


def test_a_channel_outside_has_no_value_and_json_says_null():
    content = HOLED.as_dict()
    assert content["c"] == [1.0, None, 3.0]
    assert content["flag"] == ["ok", "outside", "uncertain"]
    assert HOLED.c is not None
    assert HOLED.filled(HOLED.c).tolist() == [1.0, 2.0, 3.0]


def test_c_over_h_does_not_depend_on_g_ant():
    # C^2 = G_ant / s: what a fit determines is s, so C/|H| is its root whatever G_ant was
    slope = np.array([4.0, 9.0, 16.0])
    for gain in (np.ones(3), np.array([3.5, 310.0, 19.0])):
        curve = replace(GOOD, c=np.sqrt(gain / slope), antenna_gain=gain)
        np.testing.assert_allclose(curve.c_over_h, slope**-0.5, rtol=1e-15)
    assert replace(FAILED, antenna_gain=np.ones(3)).c_over_h is None


def test_g_ant_has_one_hash_for_the_same_numbers_and_another_for_others():
    one, same, other = (replace(GOOD, antenna_gain=np.full(3, value)) for value in (2.0, 2.0, 2.1))
    assert one.antenna_gain_sha256 == same.antenna_gain_sha256 != other.antenna_gain_sha256
    assert one.as_dict()["antenna_gain_sha256"] == one.antenna_gain_sha256
    assert parse_curve(one.as_dict()).as_dict() == one.as_dict()


def test_the_payload_of_a_version_made_before_g_ant_and_flags_were_kept_is_what_it_was():
    # payload_sha256 is the hash of these values: a null more, and every pinned answer would change
    assert not {"antenna_gain", "antenna_gain_sha256", "c_over_h", "flag"} & set(GOOD.as_dict())
    assert GOOD.flags.tolist() == ["ok"] * 3


def test_the_status_of_a_report_is_that_of_its_worst_curve():
    assert REPORT.status == TOO_FEW_EVENTS
    assert replace(REPORT, curves=(GOOD, STATION)).status == CONVERGED
    assert STATUSES[0] == CONVERGED


def test_the_report_holds_every_curve_and_no_nan():
    content = json.loads(json.dumps(REPORT.as_dict(), allow_nan=False))
    assert content["status"] == TOO_FEW_EVENTS
    assert [curve["status"] for curve in content["curves"]] == [CONVERGED, TOO_FEW_EVENTS, CONVERGED]
    assert content["curves"][1]["c"] is None
    assert content["curves"][0]["parameters"]["n_lna"] == {"value": 0.5, "sigma": 0.01}
    assert content["provenance"]["inputs"] == {"spectra": "ab"}


def test_a_head_holds_every_covariance_by_its_path_and_the_budgets(calibrations):
    head = make_head(calibrations | {"provenance": {"inputs": {}}})
    assert head["format"] == FORMAT
    assert list(head["covariances"]) == ["CS002 4 X", "CS002 4 Y", "CS002 17 X", "CS002 17 Y"]
    assert head["budgets"] == calibrations["budgets"]
    assert head["provenance"] == {"inputs": {}}
    assert all(head[name] == calibrations[name] for name in ("at", "as_of"))


def test_a_head_says_where_the_antennas_stand_how_their_arms_point_and_which_models_were_used():
    instrument = load_instrument("lofar-superterp")
    made = describe_made_with(instrument, {"sky": "gsm", "antenna": "hamaker", "dipoles": {}})
    assert made["instrument"]["dipoles"] == {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}}
    assert made["instrument"]["sha256"] == instrument.digest()
    assert made["models"] == {"sky": "gsm", "antenna": "hamaker"}
    assert "sites" not in made["instrument"]
    assert "models" not in describe_made_with(instrument, None)


def test_what_agrees_with_itself_has_no_problem_nor_have_versions_from_before_covariances(calibrations):
    assert find_problems(calibrations) == []
    arms = {"dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}}}
    assert find_problems(calibrations | {"instrument": arms}) == []
    for curve in calibrations["curves"]:
        curve["covariance"] = curve["c_sigma_sys"] = None
    assert find_problems(calibrations | {"budgets": {}}) == []


def spoil(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Sets a value deep in the content; the path is of keys and numbers."""
    *way, last = path.split(".")

    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for step in way:
            place = place[int(step) if isinstance(place, list) else step]
        place[int(last) if isinstance(place, list) else last] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (spoil("at", "2014"), "at: expected ISO 8601, found '2014'"),
        (spoil("curves", []), "there is no curve"),
        (spoil("curves.1.dipole", "X"), "CS002 4 X: given twice"),
        (spoil("instrument", {"dipoles": {"X": {}}}), "CS002 4 Y: the instrument has no arm Y, but X"),
        (spoil("curves.0.valid.to", "2013-01-01T00:00:00Z"), "which is not before 2013"),
        (spoil("curves.0.frequency_mhz.3", 32.0), "frequency_mhz: expected rising numbers"),
        (spoil("curves.0.flag.3", "good"), "flag: expected ok, uncertain, interference, outside, found good"),
        (spoil("curves.0.c.3", None), "c at 33 MHz: expected a number > 0 unless the flag is outside"),
        (spoil("curves.0.c.50", 1e-5), "c at 80 MHz: expected"),
        (spoil("curves.0.c", [1e-5] * 50), "c: expected 51 channels, found 50"),
        (spoil("curves.0.flag", ["ok"] * 52), "flag: expected 51 channels, found 52"),
        (spoil("curves.0.c_sigma_stat.3", -1e-9), "c_sigma_stat at 33 MHz"),
        (spoil("curves.0.c_sigma_sys.3", None), "c_sigma_sys: expected a number > 0 in every channel"),
        (spoil("curves.0.c_sigma_sys.3", 1e-6), "covariance: expected c_sigma_sys^2"),
        (spoil("curves.0.c_sigma_stat.3", 1e-6), "covariance: expected c_sigma_stat^2"),
        (spoil("curves.0.c_over_h.3", 1e-6), "c_over_h: expected c over the root of antenna_gain"),
        (spoil("curves.0.covariance.statistical.diagonal", [1e-6] * 50), "covariance: expected 51 channels"),
        (spoil("curves.0.covariance.systematic.budget", "c" * 64), "does not hold the budget cccccccccccc"),
        (spoil("curves.0.c", 3), "its fields are not those of a curve"),
        (spoil("curves.0.covariance.statistical", {}), "its fields are not those of a curve"),
        (spoil("curves.0.dipole", "Z"), "no vectors for the dipole Z"),
    ],
)
def test_each_contradiction_is_one_sentence(calibrations, change, said):
    change(calibrations)
    problems = find_problems(calibrations)
    assert any(said in problem for problem in problems), problems


def test_every_defect_of_a_curve_is_told_and_none_twice(calibrations):
    curve = calibrations["curves"][0]
    curve["c"][3] = curve["c"][4] = None
    curve["c_sigma_stat"][5] = -1e-9
    curve["c_sigma_sys"][6] = None
    curve["c_over_h"][7] *= 2.0
    told = [problem.removeprefix("CS002 4 X: ").partition(":")[0] for problem in find_problems(calibrations)]
    assert told == ["c at 33, 34 MHz", "c_sigma_stat at 35 MHz", "c_sigma_sys", "c_over_h"]


def test_a_budget_whose_content_was_changed_has_another_hash(calibrations):
    (budget,) = calibrations["budgets"].values()
    budget["terms"][0]["source"] = "elsewhere"
    (problem,) = find_problems(calibrations)
    assert "its content has another hash" in problem
