"""A small instance of `./dev prove own_cable`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of
from validation.own_cable import CABLES, SCOPES, SETTINGS, tell_campaign, tell_unlike


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    settings = replace(SETTINGS, stations=("CS002", "CS003", "CS004", "CS005"), antennas=16, events_per_year=200)
    return [tell_campaign(settings, seed) for seed in range(6)]


@pytest.mark.parametrize("scope", ["own", "station", "array"])
def test_the_truth_of_every_path_lies_within_the_error_that_it_is_told(rows: list[Row], scope: str) -> None:
    # the errors of a campaign have much in common: 6 campaigns know a rate to 0.02-0.03
    assert np.mean([row[scope]["all"]["within_1"] for row in rows]) == pytest.approx(0.68, abs=0.12)
    assert np.mean([row[scope]["all"]["within_2"] for row in rows]) == pytest.approx(0.95, abs=0.06)


def test_no_cable_is_told_another_ones_curve(rows: list[Row]) -> None:
    # without the path's own cable these medians are +0.36 to +0.57 (50 m) and -0.25 to -0.42 (115 m)
    for scope in ("station", "array"):
        for cable in CABLES:
            assert abs(np.mean([row[scope][cable]["offset"] for row in rows])) < 0.03


def test_the_array_tells_its_spread_and_a_silent_station_more_with_a_flag(rows: list[Row]) -> None:
    own, near, far = (np.mean([row[scope]["all"]["told"] for row in rows]) for scope in ("station", "array", "silent"))
    assert own < near < far
    assert {row["array"]["uncertain"] for row in rows} == {0.0}
    assert {row["silent"]["uncertain"] for row in rows} == {1.0}


def test_the_judgement_refutes_errors_that_are_too_small_and_curves_of_other_cables(rows: list[Row]) -> None:
    boasting = [{scope: {**row[scope]} for scope in SCOPES} for row in rows]
    for row in boasting:
        row["own"]["all"] = {**row["own"]["all"], "within_1": 0.3, "within_2": 0.6}
        row["station"]["50"] = {**row["station"]["50"], "offset": 0.4}
    verdict = verdicts_of("own_cable", "superterp", boasting)
    assert [verdict[key] for key in ("own_1", "own_2", "offset_50")] == ["refuted"] * 3


def test_a_path_among_unlike_antennas_is_told_a_larger_error() -> None:
    alike, unlike = tell_unlike(0), tell_unlike(3)
    assert (alike["unlike"], unlike["unlike"]) == (0.0, 0.17)
    assert unlike["station"]["all"]["told"] > 2 * alike["station"]["all"]["told"]
    assert unlike["own"]["all"]["told"] < 1.5 * alike["own"]["all"]["told"], "its own curve knows the antenna"
    assert 0.85 < unlike["station"]["all"]["within_2"] < 1.0
    refuted = [unlike | {"station": {"all": {**unlike["station"]["all"], "within_2": 0.7}}}] * 12
    assert (
        verdicts_of("own_cable", "unlike", [alike | {"unlike": size} for size in (0.0, 0.05, 0.1)] * 12 + refuted)[
            "station_17"
        ]
        == "refuted"
    )
