from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.model import SEASON_PRIOR, STEPS, YEAR_S, Terms, fit_terms, month_columns, smooth_columns

MONTHS = 60
TIME = np.arange(MONTHS) * YEAR_S / 12


def _terms(dates: list[list[float]], slope: bool = True) -> Terms:
    table = np.array(dates)
    return Terms(np.full(len(table), slope), table, np.zeros(table.shape, dtype=bool))


def _columns(terms: Terms) -> np.ndarray:
    known = np.ones((len(terms.dates), MONTHS), dtype=bool)
    return month_columns(smooth_columns(TIME, TIME.mean()), terms, TIME, known, np.arange(MONTHS))


def test_terms_are_recovered_exactly_without_noise() -> None:
    columns = _columns(_terms([[TIME[20] - 1.0, np.inf], [TIME[10] - 1.0, TIME[40] - 1.0]]))
    truth = np.array([[0.1, 0.02, -0.01, 0.003, 0.0, 0.01, 0.05, 0.0], [0.0, 0.0, 0.01, 0.0, 0.0, -0.02, 0.03, -0.04]])
    y = (columns @ truth[..., None])[..., 0][None]
    inverse = np.broadcast_to(1e8 * np.eye(MONTHS), (1, 2, MONTHS, MONTHS))
    fit = fit_terms(y, inverse, columns, np.ones((1, 2)))
    assert fit.theta[0] == pytest.approx(truth, abs=1e-6)


def test_the_fit_is_generalised_least_squares() -> None:
    rng = np.random.default_rng(1)
    columns = _columns(_terms([[TIME[20] - 1.0]]))
    root = rng.standard_normal((MONTHS, MONTHS)) / 8 + np.eye(MONTHS)
    y = rng.standard_normal(MONTHS)
    fit = fit_terms(y[None, None], (root.T @ root)[None, None], columns, np.ones((1, 1)))
    prior = np.zeros((4, columns.shape[2]))
    prior[np.arange(4), 1 + np.arange(4)] = 1.0 / np.array(SEASON_PRIOR)
    oracle = np.linalg.lstsq(np.vstack([root @ columns[0], prior]), np.append(root @ y, np.zeros(4)), rcond=None)[0]
    assert fit.theta[0, 0] == pytest.approx(oracle, abs=1e-6)


def test_a_step_within_a_month_has_the_part_of_its_events() -> None:
    time_unix = np.arange(20.0)
    known = np.ones((1, 20), dtype=bool)
    known[0, 12:14] = False
    columns = month_columns(
        smooth_columns(np.array([5.0, 15.0]), 10.0), _terms([[16.5]]), time_unix, known, np.array([0, 10])
    )
    assert columns[0, :, STEPS].tolist() == [0.0, 3 / 8]
