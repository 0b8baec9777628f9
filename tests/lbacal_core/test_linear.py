"""Oracles are NumPy's pseudo-inverse of one matrix at a time, eigenvalues written out, and long doubles."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import lbacal_core
from lbacal_core.linear import (
    SHARE,
    find_whitener,
    fit_least_squares,
    invert_symmetric,
    minus_log_likelihood,
    pseudo_invert,
    root_of,
    root_of_inverse,
    scale_to_unit_diagonal,
    solve_symmetric,
)


def matrices(eigenvalues: list[float], count: int = 4) -> np.ndarray:
    """Symmetric matrices of some eigenvalues, shape (count, k, k)."""
    axes = np.linalg.qr(np.random.default_rng(2).normal(size=(count, len(eigenvalues), len(eigenvalues))))[0]
    return (axes * np.array(eigenvalues)) @ np.swapaxes(axes, 1, 2)


def slow_inverse(matrix: np.ndarray, share: float = SHARE) -> np.ndarray:
    """The rule for one matrix, a direction after the other."""
    kept = [k for k in range(len(matrix)) if matrix[k, k] > 0]
    size = np.sqrt(np.diag(matrix)[kept])
    values, vectors = np.linalg.eigh(matrix[np.ix_(kept, kept)] / np.outer(size, size))
    found = np.zeros_like(matrix)
    for value, vector in zip(values, vectors.T, strict=True):
        if value > share * values[-1]:
            found[np.ix_(kept, kept)] += np.outer(vector / size, vector / size) / value
    return found


def eliminate(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Gauss's elimination in long doubles (19 digits)."""
    rows = np.concatenate([matrix, target], axis=1).astype(np.longdouble)
    for k in range(len(rows)):
        rows[k] /= rows[k, k]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, k] * rows[k]
    return rows[:, len(matrix) :]


def test_well_determined_answers_are_those_of_nineteen_digits():
    matrix, target = matrices([1e-7, 1e-4, 0.1, 1.0, 2.0]), np.random.default_rng(3).normal(size=(4, 5, 2))
    found = solve_symmetric(matrix, target)
    for one, right, answer in zip(matrix, target, found, strict=True):
        expected = np.asarray(eliminate(one, right), dtype=float)
        assert np.abs(answer - expected).max() < 1e-9 * np.abs(expected).max()  # condition 2e7 times 2e-16
        plain = np.linalg.solve(one, right)
        assert np.abs(answer - plain).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("smallest", [0.0, 1e-15, 1e-12, 1e-10, 1e-6])
def test_a_direction_below_the_share_is_not_there_and_one_above_it_is(smallest):
    matrix = matrices([smallest, 0.3, 1.0, 2.0])
    found = invert_symmetric(matrix)
    # the smallest eigenvalue is known to some roundings of the largest
    precision = max(1e-9, 3e-15 / smallest) if smallest > SHARE else 1e-9
    for one, answer in zip(matrix, found, strict=True):
        expected = slow_inverse(one)
        assert np.abs(answer - expected).max() < precision * np.abs(expected).max()


def test_units_of_the_parameters_do_not_matter():
    units = np.array([1e-120, 1.0, 1e15, 1e130])
    for smallest in (0.3, 0.0):
        plain = matrices([smallest, 0.5, 1.0, 2.0])
        found = invert_symmetric(plain * units[:, None] * units)
        np.testing.assert_allclose(found * units[:, None] * units, invert_symmetric(plain), rtol=1e-11, atol=1e-12)
    scaled, unit = scale_to_unit_diagonal(plain)
    np.testing.assert_allclose(np.einsum("pii->pi", scaled), 1.0)
    np.testing.assert_allclose(scaled / unit[:, :, None] / unit[:, None, :], plain, atol=1e-15)


def test_a_parameter_of_which_the_data_say_nothing_is_zero():
    matrix = np.diag([4.0, 0.0, -1e-30])
    assert solve_symmetric(matrix, np.array([[8.0], [0.0], [1.0]])).ravel().tolist() == [2.0, 0.0, 0.0]
    assert np.diag(invert_symmetric(matrix)).tolist() == [0.25, 0.0, 0.0]
    assert np.diag(root_of_inverse(matrix)).tolist() == [0.5, 0.0, 0.0]


def test_parameters_that_cannot_be_told_apart_share_what_they_are_together_however_rounding_makes_them_singular():
    """A sky that does not vary ended as LinAlgError where the processor rounded the other way."""
    assert solve_symmetric(np.full((2, 2), 4.0), np.full((2, 1), 4.0)).ravel() == pytest.approx([0.5, 0.5], rel=1e-12)
    for off in (1.0, 1.0 + 1e-14, 1.0 - 1e-14):
        answer = solve_symmetric(np.array([[[1.0, off], [off, 1.0]]]), np.ones((1, 2, 1)))
        assert answer.ravel() == pytest.approx([0.5, 0.5], rel=1e-12)


def test_one_matrix_of_a_batch_changes_no_other():
    batch = matrices([0.3, 0.5, 1.0, 2.0], 6).reshape(2, 3, 4, 4)
    alone = invert_symmetric(batch)
    batch[0, 1], batch[1, 0], batch[1, 1] = matrices([0.0, 0.5, 1.0, 2.0], 1)[0], np.nan, 0.0
    found = invert_symmetric(batch)
    np.testing.assert_allclose(found[0, 1], slow_inverse(batch[0, 1]), rtol=1e-9)
    assert np.isnan(found[1, 0]).all()
    assert not found[1, 1].any()
    for at in ((0, 0), (0, 2), (1, 2)):
        np.testing.assert_allclose(found[at], alone[at], rtol=1e-12)


def test_a_prior_is_information_in_units_of_the_parameters_own():
    matrix, target = matrices([0.0, 1.0, 2.0], 1)[0], np.arange(3.0)[:, None]
    expected = np.linalg.inv(matrix + 1e-4 * np.diag(np.diag(matrix))) @ target
    np.testing.assert_allclose(solve_symmetric(matrix, target, prior=1e-4), expected, rtol=1e-9)


@pytest.mark.parametrize("smallest", [0.3, 1e-6, 0.0])
def test_roots_give_back_the_covariance_and_its_inverse(smallest):
    units = np.array([1.0, 10.0, 100.0, 1.0])
    covariance = matrices([smallest, 0.5, 1.0, 2.0]) * units[:, None] * units
    root, inverse, whitener = root_of(covariance), root_of_inverse(covariance), find_whitener(covariance)
    np.testing.assert_allclose(root @ np.swapaxes(root, 1, 2), covariance, rtol=1e-9, atol=1e-9)
    expected = np.array([slow_inverse(one) for one in covariance])
    np.testing.assert_allclose(inverse @ np.swapaxes(inverse, 1, 2), expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(whitener, 1, 2) @ whitener, expected, rtol=1e-8, atol=1e-9)
    white = whitener @ covariance @ np.swapaxes(whitener, 1, 2)
    there = np.ones(4) if smallest else np.array([0.0, 1.0, 1.0, 1.0])  # eigenvalues rise, the one not there is first
    np.testing.assert_allclose(white, np.array([np.diag(there)] * 4), atol=1e-8)


@pytest.mark.parametrize("share", [1e-6, 1e-3])
def test_a_share_of_the_callers_own_is_that_of_the_largest_eigenvalue(share):
    matrix = np.array([[1.0, 1.0 - share], [1.0 - share, 1.0]])  # eigenvalues 2 - share and share
    assert invert_symmetric(matrix, share).ravel() == pytest.approx([0.25] * 4, rel=2 * share)
    np.testing.assert_allclose(invert_symmetric(matrix, share / 4), np.linalg.inv(matrix), rtol=1e-9)
    np.testing.assert_allclose(pseudo_invert(matrix, share), np.linalg.pinv(matrix, rcond=share), rtol=1e-9)


def test_least_squares_are_those_of_numpy_whatever_the_units_of_the_columns():
    rng = np.random.default_rng(4)
    design, values = rng.normal(size=(30, 4)), rng.normal(size=(5, 30, 3))
    for units in (np.ones(4), np.array([1e-20, 1.0, 1e12, 1.0])):
        found = fit_least_squares(design * units, values) * units[:, None]
        expected = [np.linalg.lstsq(design, one, rcond=None)[0] for one in values]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
    doubled = np.concatenate([design, design[:, :1], np.zeros((30, 1))], axis=1)
    amounts = fit_least_squares(doubled, values[0, :, 0])
    np.testing.assert_allclose(doubled @ amounts, design @ expected[0][:, 0], atol=1e-12)
    assert amounts[0] == pytest.approx(amounts[4])
    assert amounts[5] == 0.0


def test_nothing_is_solved_inverted_and_whitened():
    assert solve_symmetric(np.zeros((0, 3, 3)), np.zeros((0, 3, 2))).shape == (0, 3, 2)
    for empty in (np.zeros((0, 0)), np.zeros((2, 0, 0)), np.zeros((0, 3, 3))):
        for act in (invert_symmetric, root_of, root_of_inverse, find_whitener):
            assert act(empty).shape == empty.shape
    assert pseudo_invert(np.zeros((4, 0))).shape == (0, 4)
    assert fit_least_squares(np.zeros((4, 0)), np.ones(4)).shape == (0,)


def test_the_likelihood_is_that_of_normal_values():
    rng = np.random.default_rng(4)
    roots = rng.normal(size=(3, 4, 4))
    covariance, values = roots @ np.swapaxes(roots, -1, -2) + np.eye(4), rng.normal(size=(3, 4))
    normal = sum(multivariate_normal(cov=one).logpdf(of) for one, of in zip(covariance, values, strict=True))
    assert minus_log_likelihood(covariance, values).sum() == pytest.approx(-2.0 * normal - 12.0 * np.log(2.0 * np.pi))


def test_the_core_solves_and_inverts_in_one_place():
    core = Path(lbacal_core.__file__).parent
    solves = re.compile(r"\b(linalg\.(solve|inv|cholesky|pinv|lstsq)\b|cho_factor|cho_solve|solve_triangular)")
    found = [path.name for path in core.rglob("*.py") if solves.search(path.read_text())]
    assert found == ["linear.py"]
