"""A small instance of `./dev prove paper`."""

from __future__ import annotations

import numpy as np
import pytest

from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of
from validation.paper import calibrate_pulses, calibrate_traces, predict_noise


@pytest.fixture(scope="module")
def pulses() -> list[Row]:
    return [calibrate_pulses(seed) for seed in range(3)]


def test_the_right_c_stays_and_a_source_beside_a_floor_leaves_the_diagonal(pulses: list[Row]) -> None:
    for row in pulses:
        assert row["right_2"] == 1.0 or abs(row["difference"]["right"]) < 3 * row["sigma"][0]
        assert row["is_source_off"]
        # the budget of C is far wider than what 20 events know, and the statistical error of C lies between
        assert row["sigma"][0] < row["sigma"][2]
        assert row["sigma"][1] < row["sigma"][2]


def test_a_budget_that_is_too_small_is_refuted(pulses: list[Row]) -> None:
    rows = [{**pulses[k % 3], "all_1": float(k % 5 == 0), "all_2": float(k % 2)} for k in range(60)]
    verdict = verdicts_of("paper", "slopes", rows)
    assert {verdict["all_1"], verdict["all_2"]} == {"refuted"}
    assert verdict["source"] == "undecided"  # 60 of 60 leave 94 %


def test_energies_of_calibrated_traces_are_known_to_their_error() -> None:
    rows = [calibrate_traces(seed) for seed in range(4)]
    # C of six antennas with 600 events is known to half a per cent, and interpolation costs less than that
    assert all(row["error"] < 0.02 for row in rows)
    assert np.mean([row["energy_2"] for row in rows]) > 0.8
    boasting = [{**rows[k % 4], "energy_1": 0.3 + 0.01 * (k % 2)} for k in range(20)]
    assert verdicts_of("paper", "traces", boasting)["energy_1"] == "refuted"


def test_noise_of_a_fitted_chain_is_the_planted_one() -> None:
    rows = [predict_noise(seed) for seed in range(4)]
    assert np.mean([row["background"] for row in rows]) < 0.01
    assert np.mean([row["electronics_2"] for row in rows]) > 0.8
    louder = [{**rows[k % 4], "mean_square": 1.1 + 0.001 * (k % 2)} for k in range(20)]
    assert verdicts_of("paper", "noise", louder)["mean_square"] == "refuted"
