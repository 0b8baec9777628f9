"""A small instance of `./dev prove drift`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from validation import drift
from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of

WORLD = replace(drift.SMALL_WORLD, years=3.0, antennas=12, events_per_year=500)


@pytest.fixture(scope="module")
def steps() -> list[Row]:
    return [drift.plant_steps(WORLD, seed, paths_a_size=4) for seed in range(4)]


def test_years_and_seasons_raise_no_alarm() -> None:
    rows = [drift.look(WORLD, seed, (0.25, 1, 2, 3)) for seed in range(3)]
    assert np.mean([row["alarmed"] for row in rows]) <= 0.05
    assert verdicts_of("drift", "nothing", rows)["month"] == "shown"


def test_steps_of_three_per_cent_are_found_and_dated(steps: list[Row]) -> None:
    large = [s for row in steps for s in row["steps"] if abs(s["size"]) == drift.LADDER[0]]
    assert sum(s["found"] for s in large) >= 15, f"of {len(large)}"
    within = [s["within"] for s in large if s["found"]]
    assert np.mean(within) >= 0.75, "16 draws of 0.95 have fewer than 13 inside in 1 of 100"


def test_the_judgement_refutes_a_finder_that_is_blind(steps: list[Row]) -> None:
    blind = [{**row, "steps": [{"size": s["size"], "found": False} for s in row["steps"]]} for row in steps]
    assert verdicts_of("drift", "steps", [*steps, *blind])["found"] == "refuted"
    assert "size_90" not in verdicts_of("drift", "steps", blind)


def test_the_size_that_is_found_in_90_per_cent_is_measured_between_its_neighbours() -> None:
    rng = np.random.default_rng(3)
    steps = [{"size": size, "found": bool(rng.random() < 1.0 - np.exp(-size / 0.003))} for size in 200 * drift.NEAR_90]
    half, most = drift.measure_detection([{"steps": steps}])
    assert half.found < 0.0035
    assert most.found == pytest.approx(0.003 * np.log(10), rel=0.1), "a normal integral is not the law that was drawn"
    low, high = most.bounds(0.95)
    assert low < most.found < high


def test_a_slope_is_found_within_three_years() -> None:
    rows = [drift.plant_slopes(WORLD, seed, paths=8) for seed in range(2)]
    assert np.mean([row["found"] for row in rows]) >= 0.95
    assert verdicts_of("drift", "slopes", rows)["found"] != "refuted"


def test_what_a_station_or_a_board_shares_is_reported_once() -> None:
    rows = [drift.plant_in_stations(replace(WORLD, stations=6, events_per_year=900), seed) for seed in range(3)]
    assert sum(row["station_once"] for row in rows) >= 2
    assert sum(row["board_once"] for row in rows) >= 2
    assert "refuted" not in verdicts_of("drift", "stations", rows).values()


def test_the_error_of_the_trend_of_the_whole_covers() -> None:
    rows = [drift.age(replace(drift.SMALL_WORLD, events_per_year=120), seed) for seed in range(12)]
    inside = [abs(row["steps"]["slope"] - row["trend"]) < row["steps"]["limit"] for row in rows]
    assert sum(inside) >= 10, "12 draws of 0.95 have fewer than 10 inside in 2 of 100"
    assert np.median([row["steps"]["sigma"] for row in rows]) == pytest.approx(0.0095, rel=0.4)
    assert len(verdicts_of("drift", "whole", rows)) == 5
