from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve

from lbacal_core.calibration.normal_equations import RIDGE, scale_to_unit_diagonal, solve_normal_equations


def normal_matrices(units: np.ndarray) -> np.ndarray:
    design = np.random.default_rng(2).normal(size=(3, 40, units.size))
    return np.matmul(design.transpose(0, 2, 1), design) * np.outer(units, units)


def test_the_answer_is_that_of_cholesky() -> None:
    normal = normal_matrices(np.ones(5))
    target = np.random.default_rng(3).normal(size=(3, 5, 2))
    expected = [cho_solve(cho_factor(one), right) for one, right in zip(normal, target, strict=True)]
    assert solve_normal_equations(normal, target) == pytest.approx(np.array(expected), rel=1e-11)


def test_the_units_of_the_parameters_do_not_matter() -> None:
    units = np.array([1e-20, 1.0, 1e15])
    plain = solve_normal_equations(normal_matrices(np.ones(3)), np.ones((3, 3, 1)))
    scaled = solve_normal_equations(normal_matrices(units), np.ones((3, 3, 1)) * units[:, None])
    assert scaled * units[:, None] == pytest.approx(plain, rel=1e-12)
    matrices, _ = scale_to_unit_diagonal(normal_matrices(units))
    assert np.einsum("pii->pi", matrices) == pytest.approx(1.0)


def test_two_parameters_that_cannot_be_told_apart_share_what_they_are_together() -> None:
    normal = np.array([[[4.0, 4.0], [4.0, 4.0]]])
    answer = solve_normal_equations(normal, np.full((1, 2, 1), 4.0))
    assert answer.sum() == pytest.approx(1.0, abs=10 * RIDGE)


def test_a_parameter_of_which_the_data_say_nothing_is_zero() -> None:
    normal = np.array([[[4.0, 0.0], [0.0, 0.0]]])
    answer = solve_normal_equations(normal, np.array([[[8.0], [0.0]]]))
    assert answer.ravel() == pytest.approx([2.0, 0.0], rel=1e-12)


def test_what_rounding_makes_singular_in_spite_of_the_ridge_is_solved_and_not_raised() -> None:
    """A sky that does not vary ended as LinAlgError where the processor rounded the other way."""
    off = 1.0 + RIDGE
    answer = solve_normal_equations(np.array([[[1.0, off], [off, 1.0]]]), np.ones((1, 2, 1)))
    assert answer.ravel() == pytest.approx([0.5, 0.5], rel=1e-12)
