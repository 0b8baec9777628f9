import numpy as np
import pytest
from scipy import stats

from lbacal_core.drift.model import (
    SEASON_PRIOR,
    SLOPE,
    STEPS,
    Lasting,
    Terms,
    correlate_modes,
    estimate_lasting,
    find_significance,
    find_threshold,
    fit_terms,
    invert_covariance,
    month_columns,
    profile_steps,
    score_episodes,
    score_slope,
    score_steps,
    smooth_columns,
)
from lbacal_core.grids import YEAR_S

MONTHS = 60
TIME = np.arange(MONTHS) * YEAR_S / 12


def _terms(dates: list[list[float]], slope: bool = True) -> Terms:
    table = np.array(dates)
    return Terms(np.full(len(table), slope), table, np.zeros(table.shape, dtype=bool))


def _columns(terms: Terms) -> np.ndarray:
    known = np.ones((len(terms.dates), MONTHS), dtype=bool)
    return month_columns(smooth_columns(TIME, TIME.mean()), terms, TIME, known, np.arange(MONTHS))


def test_terms_are_recovered_exactly_without_noise():
    columns = _columns(_terms([[TIME[20] - 1.0, np.inf], [TIME[10] - 1.0, TIME[40] - 1.0]]))
    truth = np.array([[0.1, 0.02, -0.01, 0.003, 0.0, 0.01, 0.05, 0.0], [0.0, 0.0, 0.01, 0.0, 0.0, -0.02, 0.03, -0.04]])
    y = (columns @ truth[..., None])[..., 0][None]
    inverse = np.broadcast_to(1e8 * np.eye(MONTHS), (1, 2, MONTHS, MONTHS))
    fit = fit_terms(y, inverse, columns, np.ones((1, 2)))
    assert fit.theta[0] == pytest.approx(truth, abs=1e-6)


def test_the_fit_is_generalised_least_squares():
    rng = np.random.default_rng(1)
    columns = _columns(_terms([[TIME[20] - 1.0]]))
    root = rng.standard_normal((MONTHS, MONTHS)) / 8 + np.eye(MONTHS)
    y = rng.standard_normal(MONTHS)
    fit = fit_terms(y[None, None], (root.T @ root)[None, None], columns, np.ones((1, 1)))
    prior = np.zeros((4, columns.shape[2]))
    prior[np.arange(4), 1 + np.arange(4)] = 1.0 / np.array(SEASON_PRIOR)
    oracle = np.linalg.lstsq(np.vstack([root @ columns[0], prior]), np.append(root @ y, np.zeros(4)), rcond=None)[0]
    assert fit.theta[0, 0] == pytest.approx(oracle, abs=1e-6)


def test_a_step_within_a_month_has_the_part_of_its_events():
    time_unix = np.arange(20.0)
    known = np.ones((1, 20), dtype=bool)
    known[0, 12:14] = False
    columns = month_columns(
        smooth_columns(np.array([5.0, 15.0]), 10.0), _terms([[16.5]]), time_unix, known, np.array([0, 10])
    )
    assert columns[0, :, STEPS].tolist() == [0.0, 3 / 8]


SEVEN_YEARS = np.arange(84).astype("datetime64[M]")
EVENTS = np.full((100, 84), 70.0)
SMOOTH = smooth_columns(np.arange(84) * YEAR_S / 12, 0.0)


def _draw(lasting: Lasting, rng: np.random.Generator) -> np.ndarray:
    covariance = lasting.covariance(SEVEN_YEARS) + np.eye(84) / 70.0
    return rng.standard_normal((100, 84)) @ np.linalg.cholesky(covariance).T


@pytest.mark.parametrize("length", [0.3, 8.0])
def test_what_lasts_is_estimated_from_many_series(length):
    y = _draw(Lasting(1.0 / 70.0, length), np.random.default_rng(1))
    found = estimate_lasting(y, EVENTS, SMOOTH, np.full(100, 0.0175), SEVEN_YEARS, np.zeros((100, 84)))
    assert found.length_months == length
    assert found.variance * 70.0 == pytest.approx(1.0)


def test_white_noise_has_nothing_that_lasts():
    y = _draw(Lasting(0.0, 1.0), np.random.default_rng(2))
    found = estimate_lasting(y, EVENTS, SMOOTH, np.full(100, 0.0175), SEVEN_YEARS, np.zeros((100, 84)))
    assert found.variance * 70.0 <= 0.03


def test_a_month_without_events_has_no_weight():
    events = np.full((1, 84), 70.0)
    events[0, 10] = 0.0
    inverse = invert_covariance(events, Lasting(1.0 / 70.0, 2.0), SEVEN_YEARS)
    assert np.abs(inverse[0, 10]).max() < 1e-4
    assert inverse[0, 11, 11] > 30.0


def test_the_correlation_of_modes_is_theirs():
    rng = np.random.default_rng(3)
    first, second = rng.standard_normal((2, 100, 84)) / 70**0.5
    found = correlate_modes(np.stack([first, 0.6 * first + 0.8 * second]), EVENTS)
    assert found[0, 1] == pytest.approx(0.6, abs=0.03)


THREE_YEARS = 36
MONTHLY = np.arange(THREE_YEARS) * YEAR_S / 12
SCALE = np.full((1, 3), 0.01)


def _case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    terms = Terms(np.zeros(3, dtype=bool), np.full((3, 1), np.inf), np.zeros((3, 1), dtype=bool))
    known = np.ones((3, THREE_YEARS), dtype=bool)
    columns = month_columns(smooth_columns(MONTHLY, MONTHLY.mean()), terms, MONTHLY, known, np.arange(THREE_YEARS))
    root = rng.standard_normal((1, 3, THREE_YEARS, THREE_YEARS)) / 6 + np.eye(THREE_YEARS)
    return rng.standard_normal((1, 3, THREE_YEARS)), np.swapaxes(root, -1, -2) @ root, columns


def _oracle(y: np.ndarray, inverse: np.ndarray, columns: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Chi-square of a column: fit it beside the others, and divide its size by its error."""
    free = np.concatenate([columns[:, :, :-1], np.broadcast_to(column[None, :, None], (3, THREE_YEARS, 1))], axis=2)
    fit = fit_terms(y, inverse, free, SCALE)
    return fit.theta[0, :, -1] ** 2 / fit.covariance[0, :, -1, -1]


def test_a_score_is_what_a_fit_with_the_step_would_give():
    y, inverse, columns = _case()
    profiled = profile_steps(inverse, columns, fit_terms(y, inverse, columns, SCALE))
    scores, episodes = score_steps(*profiled, np.eye(1)), score_episodes(*profiled, np.eye(1))
    number = np.arange(THREE_YEARS)
    for month, end in ((1, 3), (7, 8), (20, 33), (34, 35)):
        step = (number >= month).astype(float)
        amid = step - 0.5 * (number == month)
        best = np.maximum(*(_oracle(y, inverse, columns, one) for one in (step, amid)))
        assert scores[:, month] == pytest.approx(best, rel=1e-4)
        episode = ((number >= month) & (number < end)).astype(float)
        assert episodes[:, month, end] == pytest.approx(_oracle(y, inverse, columns, episode), rel=1e-4)


def test_the_score_of_a_slope_is_what_a_fit_with_it_would_give():
    y, inverse, columns = _case()
    slope = smooth_columns(MONTHLY, MONTHLY.mean())[:, SLOPE]
    found = score_slope(inverse, columns, fit_terms(y, inverse, columns, SCALE), np.eye(1), slope)
    assert found == pytest.approx(_oracle(y, inverse, columns, slope), rel=1e-4)


def test_the_threshold_is_exceeded_as_often_as_allowed_and_significance_is_that_of_a_normal():
    assert 1000 * stats.chi2.sf(find_threshold(0.05, 1000, 3), 3) == pytest.approx(0.05)
    assert find_significance(np.array([9.0]), 1) == pytest.approx([3.0])
    assert find_significance(np.array([4e4]), 3) == pytest.approx([200.0])
