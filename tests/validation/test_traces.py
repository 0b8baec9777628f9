"""Small instances of the proof `traces`, with the same code."""

from __future__ import annotations

import numpy as np
import pytest

from validation.machinery.records import verdicts_of
from validation.traces import band_shape, noise_over_theory, true_bins, try_gains, try_noise, try_pulses
from validation.traces_lines import CLAIMS, KINDS, PARTS, LineTrial, try_bands, try_lines


def test_noise_is_measured_without_bias_and_with_the_noise_of_theory() -> None:
    rows = [try_noise(200, seed) for seed in range(60)]
    band = np.array([row["ratio"] for row in rows]).mean(axis=1)
    error = band.std(ddof=1) / np.sqrt(len(band))
    assert error < 0.001
    assert abs(band.mean() - 1) < 0.002 + 2 * error
    # 60 x 51 values: the scatter is known to 1.3 %; neighbouring bins share channels.
    assert abs(noise_over_theory(rows) - 1) < 0.03 + 0.013
    assert sum(row["false_lines"] for row in rows) <= 8  # 0.03 a trace expected


def test_rounding_adds_a_twelfth_unless_the_gain_is_too_low() -> None:
    each = [try_gains(seed, np.array([0.4, 1.0, 5.0]), 200)["ratio"] for seed in range(4)]
    ratios, errors = np.mean(each, axis=0), np.std(each, axis=0, ddof=1) / 2
    assert ratios[0, 1] == pytest.approx(1 + 0.51 / 12 / 0.9, abs=0.01)  # 51 of 100 MHz, 90 % of the power
    assert np.all(np.abs(ratios[1, 1:] - 1) < 0.002 + 3 * errors[1, 1:])
    assert abs(ratios[1, 0] - 1) > 0.05  # rounding is no longer white noise


def test_a_pulse_does_not_leak_and_forgetting_the_exclusion_matters() -> None:
    ours, forgotten = np.mean([try_pulses(k, np.array([300.0, 2000.0]), 200)["change"] for k in range(3)], axis=0)
    assert np.all(np.abs(ours) < 0.002)
    assert forgotten[1] > 0.05


def test_true_power_of_a_bin_is_the_mean_of_what_was_drawn() -> None:
    density = band_shape(15.0)
    assert true_bins(density).size == 51
    assert np.allclose(true_bins(np.full(61, 4.0)), 4.0 + 1 / 1200)


def trial(kind: str, strengths: list[float], trials: int, seed: int, antennas: int = 1) -> LineTrial:
    each = [
        try_lines(KINDS[kind], np.array(strengths), 200, np.random.default_rng([seed, k]), antennas)
        for k in range(trials)
    ]
    found, change = (np.array(values).T for values in zip(*each, strict=True))
    return LineTrial(np.array(strengths), found, change)


def test_strong_lines_are_found_and_leave_no_bias() -> None:
    strong = trial("steady", [0.1, 10.0], trials=10, seed=2)
    assert np.all(strong.found > 0.95)
    assert np.all(np.abs(strong.bias) < 0.002 + 3 * strong.bias_error)
    assert np.all(strong.bias_error < 0.008)


def test_weak_lines_are_not_found_and_bias_by_their_own_power_at_most() -> None:
    weak = trial("drifting 50 kHz/ms", [0.005], trials=4, seed=3)
    assert weak.found[0].mean() < 0.1
    assert 0.0 < weak.bias[0] < 0.0075 + 2 * weak.bias_error[0]


def test_several_antennas_find_weaker_lines() -> None:
    alone = trial("steady", [0.02], trials=2, seed=4)
    together = trial("steady", [0.02], trials=2, seed=4, antennas=8)
    assert together.found.mean() > alone.found.mean() + 0.5


def test_several_antennas_find_wide_weak_interference_by_its_phase() -> None:
    strength = np.array([0.5])
    (bias,) = try_bands(1, 0, strength)["change"]
    together = try_bands(8, 0, strength)
    assert together["found"] == [1.0]
    assert abs(together["change"][0]) < bias / 2


def test_every_claim_about_lines_has_a_part_and_is_tried_below_and_above_its_limit() -> None:
    assert len({part.name for part in PARTS}) == len(CLAIMS) + 2
    for claim in CLAIMS:
        assert max(claim.below) < claim.limit == min(claim.above)


def test_lines_that_are_missed_or_leave_a_bias_are_refuted() -> None:
    rng, claim = np.random.default_rng(1), CLAIMS[0]
    size = len(claim.below) + len(claim.above)
    good = [{"found": [1.0] * size, "change": (1e-3 * rng.standard_normal(size)).tolist()} for _ in range(300)]
    missed = [row | {"found": [0.9] * size} for row in good]
    biased = [row | {"change": [value + 0.005 for value in row["change"]]} for row in good]
    verdicts = [[*verdicts_of("traces_lines", claim.short, rows).values()] for rows in (good, missed, biased)]
    assert verdicts == [["shown", "shown"], ["refuted", "shown"], ["shown", "refuted"]]
