import numpy as np
import pytest

from lbacal_core.drift.follow import measure_whole
from lbacal_core.drift.model import find_dates

DAY = 86_400.0


def find_step(time_unix, day, unknown=slice(0, 0)):
    """The date of a step before the 41st of 100 events, looked for about a day."""
    residual = np.where(np.arange(100) >= 40, 20.0, 0.0)[None, :, None]
    residual[:, unknown] = np.nan
    return find_dates(time_unix, residual, np.array([[20.0]]), np.array([day * DAY]))


def test_a_step_without_noise_lies_between_the_two_events_that_it_separates():
    found = find_step(np.arange(100) * DAY, 43)
    assert found.date[0] == pytest.approx(39.5 * DAY)
    assert found.sigma[0] == pytest.approx(DAY / 12**0.5)
    assert (found.earliest[0], found.latest[0]) == pytest.approx((39.025 * DAY, 39.975 * DAY))


def test_in_a_gap_the_date_is_known_to_the_gap():
    number = np.arange(100)
    found = find_step((number + np.where(number >= 40, 100, 0)) * DAY, 140)
    assert found.date[0] == pytest.approx((39 + 101 / 2) * DAY)
    assert found.sigma[0] == pytest.approx(101 * DAY / 12**0.5)


def test_events_that_are_unknown_say_nothing():
    found = find_step(np.arange(100) * DAY, 43, slice(35, 45))
    assert found.earliest[0] > 34 * DAY
    assert found.latest[0] < 45 * DAY
    assert found.sigma[0] == pytest.approx(11 * DAY / 12**0.5)


def test_stated_errors_of_dates_hold_in_noise():
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


YEAR = 365.25 * 86_400.0


def _years(levels: np.ndarray, trend: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    time_unix = np.sort(rng.uniform(0.0, levels.size * YEAR, 300 * levels.size))
    years = time_unix / YEAR
    gain = levels[years.astype(int)] + trend * years + 0.03 * np.cos(2 * np.pi * years + 1.0)
    gain += 0.01 * rng.standard_normal(years.size)
    return time_unix, np.stack([gain, 0.1 * gain], axis=1)


@pytest.mark.parametrize("correlation", ["independent", "smooth"])
def test_the_error_of_a_trend_covers_where_levels_change_at_any_date(correlation):
    """The means of years whose levels change smoothly are correlated: 57 % instead of 68.3 % lay within the error."""
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(300):
        levels = 0.05 * rng.standard_normal(9)
        if correlation == "smooth":
            levels = np.convolve(levels, [1 / 8, 6 / 8, 1 / 8], mode="valid")
        found = measure_whole(*_years(levels[:7], 0.01, rng))
        assert found is not None
        inside.append((abs(found.slope[0] - 0.01) < found.sigma[0], abs(found.slope[0] - 0.01) < found.limit[0]))
    one, two = np.mean(inside, axis=0)
    assert 0.60 < one < 0.85, "3 standard deviations of 300 draws about 0.683, and correlations that were not there"
    assert two > 0.91


def test_without_scatter_the_trend_is_exact_in_every_mode():
    found = measure_whole(*_years(np.zeros(5), 0.02, np.random.default_rng(1)))
    assert found is not None
    assert found.years == 5
    assert found.slope == pytest.approx([0.02, 0.002], rel=0.02)
    assert found.p_value < 1e-4


def test_two_years_tell_no_trend():
    assert measure_whole(*_years(np.zeros(2), 0.02, np.random.default_rng(1))) is None
    assert measure_whole(np.arange(3.0), np.full((3, 3), np.nan)) is None
