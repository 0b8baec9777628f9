from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.steps import find_steps


def test_a_step_is_found_with_its_month_size_and_the_part_of_the_month_that_had_passed() -> None:
    values = np.ones((2, 24))
    values[1, 14:] = 1.06
    values[1, 13] = 1.0 + 0.06 * 0.25  # three quarters of the month before the step
    steps = find_steps(values, np.full(values.shape, 0.01))
    assert steps.month[1] == 13
    assert steps.passed[1] == pytest.approx(0.75)
    assert steps.size[1] == pytest.approx(0.06)
    assert steps.sigma[1] == pytest.approx(0.01 * np.sqrt(1 / 13 + 1 / 10))
    assert steps.significance[0] == 0.0


def test_months_without_value_count_for_nothing() -> None:
    values = np.ones((1, 24))
    values[0, 12:] = 0.9
    gaps = values.copy()
    gaps[0, [3, 12, 20]] = np.nan
    steps = find_steps(gaps, np.full(values.shape, 0.01))
    assert steps.size[0] == pytest.approx(-0.1)
    assert steps.month[0] in (11, 12)


def test_a_short_series_has_no_step() -> None:
    steps = find_steps(np.ones((1, 4)), np.full((1, 4), 0.01))
    assert np.isnan(steps.size[0])


def test_noise_alone_rarely_passes_four_and_a_half_sigma() -> None:
    rng = np.random.default_rng(96)
    steps = find_steps(1.0 + 0.01 * rng.standard_normal((2000, 24)), np.full((2000, 24), 0.01))
    # 20 splits of a series are strongly correlated; 4.5 sigma is 7e-6 a split: at most 0.3 of 2000 expected
    assert np.count_nonzero(steps.significance > 4.5) <= 2
