"""Solve, invert and whiten by symmetric positive semi-definite matrices, and fit least squares, by one rule.

A matrix is scaled to a unit diagonal first, so that the units of its parameters do not matter. A direction whose
eigenvalue is below a share of the largest one is not there, and neither is a parameter with 0 on the diagonal: both
get 0 in a solution, in an inverse and in its root (Moore & Penrose). An inverse therefore states no error of what the
data do not determine; a caller that reads errors asks first whether they do. Designs follow the same rule, with columns
of unit length and singular values. Matrices have leading axes, any number of them; a NaN in one makes its answer NaN.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

SHARE = 1e-13
"""Eigenvalues and singular values below this share of the largest are rounding: entries that are sums of n products are
wrong by up to n roundings of 2e-16 (Higham 2002, Accuracy and Stability of Numerical Algorithms, 3.1), eigenvalues by
no more than the matrix (Weyl 1912), and n is some hundred."""
FAR = 1e5
"""Pivots of Cholesky's factor whose square exceeds the share by this factor show that no eigenvalue is near it: the
smallest pivot exceeds the smallest eigenvalue by the square of the size at most in practice, 2700 in a fit of lines."""
LARGE = 32
"""Parameters from which matrices are factored once, one by one, which is twice as quick as a batch twice."""


def scale_to_unit_diagonal(matrix: Floats) -> tuple[Floats, Floats]:
    """Scaled matrices, shape (..., k, k), and the unit of each parameter, shape (..., k).

    A parameter with 0 on the diagonal has the unit 0, and a row of zeros.
    """
    diagonal = matrix.diagonal(axis1=-2, axis2=-1)
    unit = np.where(diagonal > 0.0, diagonal, np.inf) ** -0.5
    scaled = matrix * unit[..., :, None]
    scaled *= unit[..., None, :]
    return scaled, unit


def solve_symmetric(matrix: Floats, target: Floats, share: float = SHARE, prior: float = 0.0) -> Floats:
    """Solve A x = t.

    Parameters
    ----------
    matrix, target
        A, shape (..., k, k), and t, shape (..., k, column).
    prior
        Information about each parameter being 0, in units of its own information: parameters that the data hardly tell
        apart share what they are together.

    Returns
    -------
    Shape (..., k, column).
    """
    return make_solver(matrix, share, prior)(target)


def make_solver(matrix: Floats, share: float = SHARE, prior: float = 0.0) -> Callable[[Floats], Floats]:
    """Make the function of t, shape (..., k, column), that `solve_symmetric` is; it looks at the matrices once."""
    scaled, unit = _regularise(matrix)
    if prior:
        np.einsum("...ii->...i", scaled)[...] += prior
    is_near, solve_far = (_factor_each if matrix.shape[-1] >= LARGE else _factor_together)(scaled, share)
    root = _root_of_inverse(scaled[is_near], share) if is_near.any() else None

    def solve(target: Floats) -> Floats:
        scaled_target = unit[..., None] * target
        solution = solve_far(scaled_target)
        if root is not None:
            own = np.broadcast_to(scaled_target, solution.shape)[is_near]
            solution[is_near] = root @ (np.swapaxes(root, -1, -2) @ own)
        return np.asarray(unit[..., None] * solution)

    return solve


Factored = tuple[NDArray[np.bool_], Callable[[Floats], Floats]]
"""Whether unit-diagonal matrices have an eigenvalue near the share, and the solver of those that have none."""


def _factor_together(scaled: Floats, share: float) -> Factored:
    is_near = ~_is_far(scaled, share)
    far = np.where(is_near[..., None, None], np.eye(scaled.shape[-1]), scaled) if is_near.any() else scaled
    return is_near, lambda target: np.asarray(np.linalg.solve(far, target))


def _factor_each(scaled: Floats, share: float) -> Factored:
    from scipy.linalg.lapack import dpotrf, dpotrs  # a fifth of a second to import: an API that answers does not

    shape, size = scaled.shape[:-2], scaled.shape[-1]
    # of a symmetric matrix the transpose is the one that LAPACK reads as it stands in memory
    found = [dpotrf(one.T, lower=1, clean=0) for one in scaled.reshape(-1, size, size)]
    is_far = [not failed and bool((one.diagonal() ** 2 > FAR * share).all()) for one, failed in found]
    is_near, number = ~np.array(is_far, dtype=bool).reshape(shape), np.arange(len(found)).reshape(shape)

    def solve(target: Floats) -> Floats:
        every = np.broadcast_shapes(shape, target.shape[:-2])
        solution = np.broadcast_to(target, (*every, *target.shape[-2:])).copy()
        flat = solution.reshape(-1, *target.shape[-2:])
        for own, k in zip(flat, np.broadcast_to(number, every).ravel().tolist(), strict=True):
            if is_far[k]:
                own[:] = dpotrs(found[k][0], own, lower=1)[0]
        return solution

    return is_near, solve


def invert_symmetric(matrix: Floats, share: float = SHARE) -> Floats:
    """The inverse of matrices, shape (..., k, k)."""
    return solve_symmetric(matrix, np.eye(matrix.shape[-1]), share)


def root_of_inverse(matrix: Floats, share: float = SHARE) -> Floats:
    """R with R R^T = A^-1, shape (..., k, k); columns of directions that are not there are 0."""
    scaled, unit = _regularise(matrix)
    return np.asarray(unit[..., None] * _root_of_inverse(scaled, share))


def root_of(covariance: Floats) -> Floats:
    """R with R R^T = C, shape (..., k, k): Cholesky's factor unless one of the matrices is nearly singular."""
    scaled, unit = _regularise(covariance)
    if np.all(unit > 0.0) and np.all(_is_far(scaled, SHARE)):
        return np.asarray(np.linalg.cholesky(covariance))
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def find_whitener(covariance: Floats) -> Floats:
    """W with W C W^T = 1, shape (..., k, k): triangular unless one of the matrices is nearly singular.

    What has no variance is not there: W gives it 0.
    """
    scaled, unit = _regularise(covariance)
    if np.all(unit > 0.0) and np.all(_is_far(scaled, SHARE)):
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
    return np.swapaxes(unit[..., None] * _root_of_inverse(scaled, SHARE), -1, -2)


def minus_log_likelihood(covariance: Floats, values: Floats) -> Floats:
    """-2 ln of the likelihood of normal values but for a constant (Rasmussen & Williams, 2.30), shape (series,).

    Values have the shape (series, k). Covariances, shape (series, k, k), must have no direction without variance: what
    is not there has no likelihood.
    """
    series, size = values.shape
    bordered = np.empty((series, size + 1, size + 1))
    bordered[:, :size, :size] = covariance
    bordered[:, size, :size] = values  # becomes the whitened values below the factor: half the work of solving
    bordered[:, size, size] = np.finfo(float).max  # whatever chi^2 is, the last pivot is real
    factor = np.linalg.cholesky(bordered)
    pivots = np.diagonal(factor[:, :size, :size], axis1=-2, axis2=-1)
    return np.asarray(np.sum(factor[:, size, :size] ** 2, axis=1) + 2.0 * np.sum(np.log(pivots), axis=1))


def pseudo_invert(design: Floats, share: float = SHARE) -> Floats:
    """The pseudo-inverse of matrices of any form with columns of unit length, (..., row, column) to its transpose."""
    length = np.linalg.norm(design, axis=-2)
    unit = np.where(length > 0.0, length, np.inf) ** -1.0
    return np.asarray(unit[..., None] * np.linalg.pinv(design * unit[..., None, :], rcond=share))


def fit_least_squares(design: Floats, values: Floats) -> Floats:
    """Amounts of the columns of a design, shape (row, column), in values, shape (row,) or (..., row, any)."""
    return np.asarray(pseudo_invert(design) @ values)


def _regularise(matrix: Floats) -> tuple[Floats, Floats]:
    """As `scale_to_unit_diagonal`, with 1 on the diagonal also for a parameter that is not there: its unit is 0."""
    scaled, unit = scale_to_unit_diagonal(matrix)
    if not unit.all():
        np.einsum("...ii->...i", scaled)[unit == 0.0] = 1.0
    return scaled, unit


def _is_far(scaled: Floats, share: float) -> NDArray[np.bool_]:
    """Whether no eigenvalue of unit-diagonal matrices is near the share, shape (...)."""
    # a hundredth of what is looked for keeps one singular matrix from stopping all others
    lifted = FAR / 100.0 * share * np.eye(scaled.shape[-1])
    try:
        factor = np.linalg.cholesky(scaled + lifted)
    except np.linalg.LinAlgError:  # NaN, or negative beyond rounding: eigenvalues say where
        return np.zeros(scaled.shape[:-2], dtype=bool)
    return np.asarray((factor.diagonal(axis1=-2, axis2=-1) ** 2 > FAR * share).all(axis=-1))


def _root_of_inverse(scaled: Floats, share: float) -> Floats:
    is_finite = np.all(np.isfinite(scaled), axis=(-2, -1), keepdims=True)
    values, vectors = np.linalg.eigh(np.where(is_finite, scaled, 0.0))
    is_there = values > share * values[..., -1:]
    root = vectors * (np.where(is_there, values, np.inf) ** -0.5)[..., None, :]
    return np.where(is_finite, root, np.nan)
