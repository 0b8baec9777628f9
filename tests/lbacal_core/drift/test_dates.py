from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.model import find_dates

DAY = 86_400.0


def test_a_step_without_noise_lies_between_the_two_events_that_it_separates() -> None:
    time_unix = np.arange(100) * DAY
    residual = np.where(np.arange(100) >= 40, 20.0, 0.0)[None, :, None]
    found = find_dates(time_unix, residual, np.array([[20.0]]), np.array([43 * DAY]))
    assert found.date[0] == pytest.approx(39.5 * DAY)
    assert found.sigma[0] == pytest.approx(DAY / 12**0.5)
    assert (found.earliest[0], found.latest[0]) == pytest.approx((39.025 * DAY, 39.975 * DAY))


def test_in_a_gap_the_date_is_known_to_the_gap() -> None:
    number = np.arange(100)
    time_unix = (number + np.where(number >= 40, 100, 0)) * DAY
    residual = np.where(number >= 40, 20.0, 0.0)[None, :, None]
    found = find_dates(time_unix, residual, np.array([[20.0]]), np.array([140 * DAY]))
    assert found.date[0] == pytest.approx((39 + 101 / 2) * DAY)
    assert found.sigma[0] == pytest.approx(101 * DAY / 12**0.5)


def test_stated_errors_of_dates_hold_in_noise() -> None:
    rng = np.random.default_rng(3)
    steps, events = 600, 240
    time_unix = np.sort(rng.uniform(0, 120 * DAY, events))
    truth = rng.uniform(40 * DAY, 80 * DAY, steps)
    size = np.full((steps, 1), 0.8)
    residual = rng.standard_normal((steps, events, 1)) + 0.8 * (time_unix >= truth[:, None])[..., None]
    found = find_dates(time_unix, residual, size, truth + 10 * DAY)
    within = np.mean((found.earliest <= truth) & (truth <= found.latest))
    assert within == pytest.approx(0.95, abs=0.03)  # 3 standard deviations of 600 draws
    assert np.mean(np.abs(found.date - truth) < found.sigma) > 0.65


def test_events_that_are_unknown_say_nothing() -> None:
    time_unix = np.arange(100) * DAY
    residual = np.where(np.arange(100) >= 40, 20.0, 0.0)[None, :, None]
    residual[:, 35:45] = np.nan
    found = find_dates(time_unix, residual, np.array([[20.0]]), np.array([43 * DAY]))
    assert found.earliest[0] > 34 * DAY
    assert found.latest[0] < 45 * DAY
    assert found.sigma[0] == pytest.approx(11 * DAY / 12**0.5)
