"""Small instances of the proof `traces`, with the same code."""

from __future__ import annotations

import numpy as np
import pytest

from validation.traces import band_shape, collect_noise, measure_gains, measure_noise, measure_pulses, true_bins


def test_noise_is_measured_without_bias_and_with_the_noise_of_theory() -> None:
    trial = collect_noise([measure_noise(200, np.random.default_rng([1, k])) for k in range(60)])
    bias, error = trial.bias
    assert error < 0.001
    assert abs(bias) < 0.002 + 2 * error
    # 60 x 51 values: the scatter is known to 1.3 %; neighbouring bins share channels.
    assert abs(trial.noise_over_theory - 1) < 0.03 + 0.013
    assert trial.false_lines <= 8  # 0.03 a trace expected


def test_rounding_adds_a_twelfth_unless_the_gain_is_too_low() -> None:
    each = [measure_gains(np.array([0.4, 1.0, 5.0]), 200, np.random.default_rng([5, k])) for k in range(4)]
    ratios, errors = np.mean(each, axis=0), np.std(each, axis=0, ddof=1) / 2
    assert ratios[0, 1] == pytest.approx(1 + 0.51 / 12 / 0.9, abs=0.01)  # 51 of 100 MHz, 90 % of the power
    assert np.all(np.abs(ratios[1, 1:] - 1) < 0.002 + 3 * errors[1, 1:])
    assert abs(ratios[1, 0] - 1) > 0.05  # rounding is no longer white noise


def test_a_pulse_does_not_leak_and_forgetting_the_exclusion_matters() -> None:
    each = [measure_pulses(np.array([300.0, 2000.0]), 200, np.random.default_rng([6, k])) for k in range(3)]
    ours, forgotten = np.mean(each, axis=0)
    assert np.all(np.abs(ours) < 0.002)
    assert forgotten[1] > 0.05


def test_true_power_of_a_bin_is_the_mean_of_what_was_drawn() -> None:
    density = band_shape(15.0)
    assert true_bins(density).size == 51
    assert np.allclose(true_bins(np.full(61, 4.0)), 4.0 + 1 / 1200)
