from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lbacal_core.drift.model import (
    SLOPE,
    YEAR_S,
    Terms,
    find_significance,
    find_threshold,
    fit_terms,
    month_columns,
    score_slope,
    score_steps,
    smooth_columns,
)

MONTHS = 36
TIME = np.arange(MONTHS) * YEAR_S / 12
SCALE = np.full((1, 3), 0.01)


def _case() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    terms = Terms(np.zeros(3, dtype=bool), np.full((3, 1), np.inf), np.zeros((3, 1), dtype=bool))
    known = np.ones((3, MONTHS), dtype=bool)
    columns = month_columns(smooth_columns(TIME, TIME.mean()), terms, TIME, known, np.arange(MONTHS))
    root = rng.standard_normal((1, 3, MONTHS, MONTHS)) / 6 + np.eye(MONTHS)
    return rng.standard_normal((1, 3, MONTHS)), np.swapaxes(root, -1, -2) @ root, columns


def _oracle(y: np.ndarray, inverse: np.ndarray, columns: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Chi-square of a column: fit it beside the others, and divide its size by its error."""
    free = np.concatenate([columns[:, :, :-1], np.broadcast_to(column[None, :, None], (3, MONTHS, 1))], axis=2)
    fit = fit_terms(y, inverse, free, SCALE)
    return fit.theta[0, :, -1] ** 2 / fit.covariance[0, :, -1, -1]


def test_a_score_is_what_a_fit_with_the_step_would_give() -> None:
    y, inverse, columns = _case()
    scores = score_steps(inverse, columns, fit_terms(y, inverse, columns, SCALE), np.eye(1))
    for month in (1, 7, 20, 35):
        step = (np.arange(MONTHS) >= month).astype(float)
        assert scores[:, month] == pytest.approx(_oracle(y, inverse, columns, step), rel=1e-4)


def test_the_score_of_a_slope_is_what_a_fit_with_it_would_give() -> None:
    y, inverse, columns = _case()
    slope = smooth_columns(TIME, TIME.mean())[:, SLOPE]
    found = score_slope(inverse, columns, fit_terms(y, inverse, columns, SCALE), np.eye(1), slope)
    assert found == pytest.approx(_oracle(y, inverse, columns, slope), rel=1e-4)


def test_the_threshold_is_exceeded_as_often_as_allowed() -> None:
    cut = find_threshold(0.05, 1000, 3)
    assert 1000 * stats.chi2.sf(cut, 3) == pytest.approx(0.05)


def test_significance_is_that_of_a_normal() -> None:
    assert find_significance(np.array([9.0]), 1) == pytest.approx([3.0])
    assert find_significance(np.array([4e4]), 3) == pytest.approx([200.0])
