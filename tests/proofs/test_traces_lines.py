"""Small instances of the proof `traces_lines`, with the same code."""

from __future__ import annotations

import numpy as np

from proofs.traces_lines import CLAIMS, KINDS, try_lines, try_wide


def test_strong_lines_are_found_and_leave_no_bias() -> None:
    trial = try_lines(KINDS["steady"], np.array([0.1, 10.0]), trials=10, blocks=200, seed=2)
    assert np.all(trial.found > 0.95)
    assert np.all(np.abs(trial.bias) < 0.002 + 3 * trial.bias_error)
    assert np.all(trial.bias_error < 0.008)


def test_weak_lines_are_not_found_and_bias_by_their_own_power_at_most() -> None:
    trial = try_lines(KINDS["drifting 50 kHz/ms"], np.array([0.005]), trials=4, blocks=200, seed=3)
    assert trial.found[0].mean() < 0.1
    assert 0.0 < trial.bias[0] < 0.0075 + 2 * trial.bias_error[0]


def test_several_antennas_find_weaker_lines() -> None:
    strength = np.array([0.02])
    alone = try_lines(KINDS["steady"], strength, trials=2, blocks=200, seed=4)
    together = try_lines(KINDS["steady"], strength, trials=2, blocks=200, seed=4, antennas=8)
    assert together.found.mean() > alone.found.mean() + 0.5


def test_several_antennas_find_wide_weak_interference_by_its_phase() -> None:
    strength = np.array([0.5])
    _, (bias,) = try_wide(strength, 0.8, trials=1, blocks=400, seed=5, antennas=1)
    (found,), (left,) = try_wide(strength, 0.8, trials=1, blocks=400, seed=5, antennas=8)
    assert found == 1.0
    assert abs(left) < bias / 2


def test_what_is_claimed_is_tried_below_and_above_its_limit() -> None:
    for claim in CLAIMS:
        assert max(claim.below) < claim.limit == min(claim.above)
