from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.model import (
    YEAR_S,
    Lasting,
    correlate_modes,
    estimate_lasting,
    invert_covariance,
    smooth_columns,
)

MONTHS = np.arange(84).astype("datetime64[M]")
EVENTS = np.full((100, 84), 70.0)
SMOOTH = smooth_columns(np.arange(84) * YEAR_S / 12, 0.0)


def _draw(lasting: Lasting, rng: np.random.Generator) -> np.ndarray:
    covariance = lasting.covariance(MONTHS) + np.eye(84) / 70.0
    return rng.standard_normal((100, 84)) @ np.linalg.cholesky(covariance).T


@pytest.mark.parametrize("length", [0.3, 8.0])
def test_what_lasts_is_estimated_from_many_series(length: float) -> None:
    y = _draw(Lasting(1.0 / 70.0, length), np.random.default_rng(1))
    found = estimate_lasting(y, EVENTS, SMOOTH, np.full(100, 0.0175), MONTHS, np.zeros((100, 84)))
    assert found.length_months == length
    assert found.variance * 70.0 == pytest.approx(1.0)


def test_white_noise_has_nothing_that_lasts() -> None:
    y = _draw(Lasting(0.0, 1.0), np.random.default_rng(2))
    found = estimate_lasting(y, EVENTS, SMOOTH, np.full(100, 0.0175), MONTHS, np.zeros((100, 84)))
    assert found.variance * 70.0 <= 0.03


def test_a_month_without_events_has_no_weight() -> None:
    events = np.full((1, 84), 70.0)
    events[0, 10] = 0.0
    inverse = invert_covariance(events, Lasting(1.0 / 70.0, 2.0), MONTHS)
    assert np.abs(inverse[0, 10]).max() < 1e-4
    assert inverse[0, 11, 11] > 30.0


def test_the_correlation_of_modes_is_theirs() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.standard_normal((2, 100, 84)) / 70**0.5
    found = correlate_modes(np.stack([first, 0.6 * first + 0.8 * second]), EVENTS)
    assert found[0, 1] == pytest.approx(0.6, abs=0.03)
