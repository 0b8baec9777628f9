from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lbacal_core.curves.galcal import find_problems


def test_what_agrees_with_itself_has_no_problem(calibrations: dict[str, Any]) -> None:
    assert find_problems(calibrations) == []
    arms = {"dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}}}
    assert find_problems(calibrations | {"instrument": arms}) == []


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
def test_each_contradiction_is_one_sentence(
    calibrations: dict[str, Any], change: Callable[[dict[str, Any]], None], said: str
) -> None:
    change(calibrations)
    problems = find_problems(calibrations)
    assert any(said in problem for problem in problems), problems


def test_a_budget_whose_content_was_changed_has_another_hash(calibrations: dict[str, Any]) -> None:
    (budget,) = calibrations["budgets"].values()
    budget["terms"][0]["source"] = "elsewhere"
    (problem,) = find_problems(calibrations)
    assert "its content has another hash" in problem


def test_versions_from_before_covariances_follow_the_format(calibrations: dict[str, Any]) -> None:
    for curve in calibrations["curves"]:
        curve["covariance"] = curve["c_sigma_sys"] = None
    assert find_problems(calibrations | {"budgets": {}}) == []
