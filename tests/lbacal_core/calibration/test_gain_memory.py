from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.gain_memory import CELLS, _sum_pairs, add_variance, find_variance_along
from lbacal_core.calibration.lines import fit_lines
from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S

DAY_S = 86_400.0


def draw_lasting(rng: np.random.Generator, time_unix: Floats, hours: float, count: int) -> Floats:
    """Amounts of unit variance whose memory is exponential, by their covariance, shape (count, event)."""
    covariance = np.exp(-np.abs(time_unix[:, None] - time_unix) / (3600.0 * hours))
    return np.asarray(rng.normal(size=(count, time_unix.size)) @ np.linalg.cholesky(covariance).T)


def rise(time_unix: Floats) -> Floats:
    """A course of the sky: two waves of the sidereal day."""
    angle = 2.0 * np.pi * time_unix / SIDEREAL_DAY_S
    return np.asarray(1.0 + 0.5 * np.cos(angle) + 0.2 * np.sin(2.0 * angle))


def test_sums_over_pairs_are_those_of_every_pair() -> None:
    rng = np.random.default_rng(1)
    values, cell = rng.normal(size=40), np.sort(rng.integers(0, 30, 40))
    expected = np.zeros(30)
    for i in range(40):
        for j in range(i):
            expected[cell[i] - cell[j]] += values[i] * values[j]
    np.testing.assert_allclose(_sum_pairs(values, cell)[:30], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("days", "hours", "wider"), [(3.0, 3.0, 28.3), (10.0, 6.0, 8.6), (30.0, 72.0, 0.9), (365.0, 24.0, 1.1)]
)
def test_the_variance_of_a_slope_is_that_of_the_covariance_of_its_gains(
    days: float, hours: float, wider: float
) -> None:
    rng, time = np.random.default_rng(2), np.sort(np.random.default_rng(3).uniform(0.0, days * DAY_S, 600))
    course = rise(time)
    x = course - course.mean()
    exact = x @ np.exp(-np.abs(time[:, None] - time) / (3600.0 * hours)) @ x / (x @ x)
    assert exact == pytest.approx(wider, abs=0.1), "over that of independent gains"
    found = 1.0 + find_variance_along(draw_lasting(rng, time, hours, 100), course, time) * (x @ x)
    assert 0.7 < found.mean() / exact < 1.7, "waves of LST are taken off, and of days a part of the memory with them"


def test_independent_amounts_and_waves_of_lst_have_no_memory() -> None:
    rng, time = np.random.default_rng(3), np.sort(np.random.default_rng(4).uniform(0.0, 3.0 * DAY_S, 400))
    amount = rng.normal(size=(200, 400))
    assert not find_variance_along(amount, rise(time), time).any()
    assert not find_variance_along(amount + 3.0 * rise(time) ** 2, rise(time), time).any()
    lasting = draw_lasting(rng, time, 3.0, 5)
    assert find_variance_along(lasting, rise(time), time).all()
    assert not find_variance_along(lasting, np.ones(400), time).any(), "a sky that does not vary has no slope"
    amount[:, 7:] = np.nan
    assert not find_variance_along(amount, rise(time), time).any(), "seven events are none to tell from"


def test_information_with_a_wider_direction_is_the_inverse_of_the_wider_covariance() -> None:
    rng = np.random.default_rng(7)
    half = rng.normal(size=(2, 6, 6))
    covariance, direction, variance = half @ half.swapaxes(1, 2), rng.normal(size=(2, 6)), np.array([0.0, 3.0])
    wider = covariance + variance[:, None, None] * direction[:, :, None] * direction[:, None, :]
    found = add_variance(np.linalg.inv(covariance), direction, variance)
    np.testing.assert_allclose(found, np.linalg.inv(wider), rtol=1e-6)


def test_slopes_of_days_whose_gains_last_are_as_uncertain_as_they_scatter() -> None:
    """Stationary gains of 2 % that last three hours: errors of independent gains were three times too small."""
    rng, time = np.random.default_rng(8), np.linspace(0.0, 3.0 * DAY_S, 432)
    sky = rise(time)[:, None] * np.linspace(2.0, 0.5, 10)
    gain = np.exp(0.02 * draw_lasting(rng, time, 3.0, 60))[:, :, None]
    power = (gain * (sky + 0.3)) * rng.normal(1.0, 0.03, (60, 432, 10))
    assert CELLS > 432
    pulls = []
    for known in (time, None):
        lines = fit_lines(power, sky, np.ones((60, 432)), None, known)
        error = np.sqrt(np.einsum("pii->pi", np.linalg.inv(lines.information)))[:, :10]
        pulls.append(np.sqrt(np.mean(((lines.slope - 1.0) / error) ** 2)))
    assert pulls[0] < 1.3
    assert pulls[1] > 2.0
