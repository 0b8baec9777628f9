from __future__ import annotations

import json

import numpy as np
import pytest

from lbacal_core.curves.covariance import (
    MOST_FACTORS,
    Budget,
    BudgetTerm,
    CurveCovariance,
    compress_covariance,
    name_budgets,
    parse_budget,
    parse_covariance,
)

FREQUENCY = np.linspace(30.0, 80.0, 6)
LEVEL = BudgetTerm("level", "a paper", {"X": np.full((1, 6), 0.1), "Y": np.full((1, 6), 0.1)})
SLOPE = BudgetTerm("slope", "another", {p: np.linspace(-0.04, 0.04, 6)[None] for p in "XY"}, is_of_gain=True)
BUDGET = Budget(FREQUENCY, (LEVEL, SLOPE))


def test_independent_terms_add_in_quadrature_and_each_is_correlated_along_frequency():
    np.testing.assert_allclose(BUDGET.variance("X"), 0.01 + SLOPE.vectors["X"][0] ** 2)
    np.testing.assert_allclose(np.diag(BUDGET.covariance("X")), BUDGET.variance("X"))
    assert BUDGET.covariance("X")[0, -1] == pytest.approx(0.01 - 0.04**2)


def test_a_budget_returns_from_json_with_its_hash():
    again = parse_budget(json.loads(json.dumps(BUDGET.as_dict(), allow_nan=False)))
    assert again.digest == BUDGET.digest
    assert [term.is_of_gain for term in again.terms] == [False, True]
    assert Budget(FREQUENCY, (SLOPE,)).digest != BUDGET.digest


def test_compressing_keeps_every_variance_and_what_moves_together():
    rng = np.random.default_rng(1)
    strong = rng.normal(size=(2, 6))
    covariance = strong.T @ strong + np.diag(rng.uniform(0.001, 0.01, 6))
    factor, diagonal = compress_covariance(covariance)
    assert factor.shape == (MOST_FACTORS, 6)
    np.testing.assert_allclose(np.sum(factor**2, axis=0) + diagonal, np.diag(covariance))
    assert np.max(np.abs(factor.T @ factor + np.diag(diagonal) - covariance)) < 0.01


def test_a_channel_without_a_value_has_no_covariance():
    covariance = np.eye(4)
    covariance[2] = covariance[:, 2] = np.nan
    factor, diagonal = compress_covariance(covariance)
    assert np.isnan(factor[:, 2]).all()
    one = CurveCovariance(factor, diagonal, None, np.zeros((0, 4)))
    text = json.dumps(one.as_dict(), allow_nan=False)
    again = parse_covariance(json.loads(text))
    np.testing.assert_allclose(again.diagonal, diagonal)
    assert again.own.shape == (0, 4)


def test_a_term_of_its_own_is_added_to_a_curve():
    one = CurveCovariance(np.ones((1, 4)), np.zeros(4), "ab", np.zeros((0, 4))).with_own(np.full(4, 0.05))
    again = parse_covariance(one.as_dict())
    assert again.own.tolist() == [[0.05] * 4]
    assert name_budgets([{"covariance": one.as_dict()}, {"covariance": None}, {}]) == ["ab"]
