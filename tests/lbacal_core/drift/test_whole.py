from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.follow import measure_whole

YEAR = 365.25 * 86_400.0


def _years(levels: np.ndarray, trend: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    time_unix = np.sort(rng.uniform(0.0, levels.size * YEAR, 300 * levels.size))
    years = time_unix / YEAR
    gain = levels[years.astype(int)] + trend * years + 0.03 * np.cos(2 * np.pi * years + 1.0)
    gain += 0.01 * rng.standard_normal(years.size)
    return time_unix, np.stack([gain, 0.1 * gain], axis=1)


@pytest.mark.parametrize("correlation", ["independent", "smooth"])
def test_the_error_of_a_trend_covers_where_levels_change_at_any_date(correlation: str) -> None:
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


def test_without_scatter_the_trend_is_exact_in_every_mode() -> None:
    found = measure_whole(*_years(np.zeros(5), 0.02, np.random.default_rng(1)))
    assert found is not None
    assert found.years == 5
    assert found.slope == pytest.approx([0.02, 0.002], rel=0.02)
    assert found.p_value < 1e-4


def test_two_years_tell_no_trend() -> None:
    assert measure_whole(*_years(np.zeros(2), 0.02, np.random.default_rng(1))) is None
    assert measure_whole(np.arange(3.0), np.full((3, 3), np.nan)) is None
