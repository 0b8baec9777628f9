"""A separable least-squares solver: one non-linear number, everything else linear, many problems at once.

It knows no physics. Each problem has measured vectors x and y with their joint information matrix W, and the model

    y = n x + H q,

x free, q a few numbers, n one number. Given n the problem is linear in (x, q), so only n is iterated (variable
projection: Golub & Pereyra 1973, SIAM J. Numer. Anal. 10, 413). At the linear optimum the derivative of chi^2 by n is
the partial one, and the Schur complement of the information matrix is its curvature: Newton's step is analytic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.normal_equations import scale_to_unit_diagonal, solve_normal_equations
from lbacal_core.grids import Floats

MAX_ITERATIONS = 50
STEP_TOLERANCE = 1e-5
"""Converged when n moves by less than this fraction of its standard deviation."""
SMALLEST_EIGENVALUE = 1e-11
"""Below this eigenvalue of the unit-diagonal information matrix of (n, q) the data do not determine them."""


@dataclass(frozen=True)
class SeparableSolution:
    """Solutions of a batch of separable problems.

    Attributes
    ----------
    x
        Shape (problem, m).
    n
        Shape (problem,).
    q
        Shape (problem, k).
    covariance
        Covariance of (x, n, q), shape (problem, m + 1 + k, m + 1 + k); NaN where not identifiable.
    chi2
        Shape (problem,); m - 1 - k degrees of freedom.
    is_converged, is_identifiable
        Shape (problem,).
    """

    x: Floats
    n: Floats
    q: Floats
    covariance: Floats
    chi2: Floats
    is_converged: NDArray[np.bool_]
    is_identifiable: NDArray[np.bool_]


def solve_separable(x: Floats, y: Floats, information: Floats, design: Floats) -> SeparableSolution:
    """Minimise chi^2 over (x, n, q) for a batch of problems.

    Parameters
    ----------
    x, y
        Measured, shape (problem, m).
    information
        Inverse covariance of (x, y), shape (problem, 2 m, 2 m).
    design
        H, shape (m, k), the same for all problems.
    """
    problems, size = x.shape
    # Unit columns: n and q may differ from x by many orders of magnitude.
    x_unit, y_unit = _typical(x), _typical(y)
    q_unit = y_unit / np.sqrt(np.mean(design**2, axis=0))
    unit = np.concatenate([np.repeat(x_unit, size, 1), np.repeat(y_unit, size, 1)], axis=1)
    weight = information * unit[:, :, None] * unit[:, None, :]
    measured = np.concatenate([x / x_unit, y / y_unit], axis=1)
    scaled_design = design * (q_unit / y_unit)[:, None, :]

    n = _start(measured[:, :size], measured[:, size:], np.einsum("pii->pi", weight[:, size:, size:]), scaled_design)
    is_converged = np.zeros(problems, dtype=bool)
    for _ in range(MAX_ITERATIONS):
        optimum = _solve_linear(n, scaled_design, weight, measured)
        has_curvature = optimum.curvature > 0
        step = np.divide(optimum.gradient, optimum.curvature, out=np.zeros(problems), where=has_curvature)
        is_converged |= np.abs(step) * np.sqrt(optimum.curvature) <= STEP_TOLERANCE
        if np.all(is_converged):
            break
        n = np.where(is_converged, n, n + step)
    is_converged &= np.isfinite(optimum.chi2)

    covariance, is_identifiable = _invert(_full_information(optimum, size), size)
    linear, chi2 = optimum.linear, optimum.chi2
    back = np.concatenate([np.repeat(x_unit, size, 1), y_unit / x_unit, q_unit], axis=1)
    return SeparableSolution(
        x=linear[:, :size] * x_unit,
        n=n * (y_unit / x_unit)[:, 0],
        q=linear[:, size:] * q_unit,
        covariance=covariance * back[:, :, None] * back[:, None, :],
        chi2=chi2,
        is_converged=is_converged,
        is_identifiable=is_identifiable,
    )


def _start(x: Floats, y: Floats, weight: Floats, design: Floats) -> Floats:
    """N of the weighted regression of y on x and H, as if x were without error; shape (problem,)."""
    columns = np.concatenate([x[:, :, None], design], axis=2)
    weighted = columns * weight[:, :, None]
    target = np.matmul(weighted.transpose(0, 2, 1), y[:, :, None])
    return solve_normal_equations(np.matmul(weighted.transpose(0, 2, 1), columns), target)[:, 0, 0]


def _typical(values: Floats) -> Floats:
    """Mean absolute value of each problem's vector, 1 where that is 0; shape (problem, 1)."""
    typical = np.abs(values).mean(axis=1, keepdims=True)
    return np.where(typical > 0, typical, 1.0)


@dataclass(frozen=True)
class _Optimum:
    """The linear optimum at one n: (x, q), chi^2, and the gradient and curvature of -chi^2 / 2 along n."""

    linear: Floats
    chi2: Floats
    gradient: Floats
    curvature: Floats
    normal: Floats
    border: Floats
    own: Floats


def _solve_linear(n: Floats, design: Floats, weight: Floats, measured: Floats) -> _Optimum:
    size = design.shape[1]
    w_xx, w_xy = weight[:, :size, :size], weight[:, :size, size:]
    w_yx, w_yy = weight[:, size:, :size], weight[:, size:, size:]
    factor = n[:, None, None]
    # The derivative of the model by (x, q) is [[1, 0], [n 1, H]]; its normal matrix written out by blocks.
    w_yh = np.matmul(w_yy, design)
    side = np.matmul(w_xy, design) + factor * w_yh
    normal = np.empty((n.size, size + design.shape[2], size + design.shape[2]))
    normal[:, :size, :size] = w_xx + factor * (w_xy + w_yx + factor * w_yy)
    normal[:, :size, size:] = side
    normal[:, size:, :size] = side.transpose(0, 2, 1)
    normal[:, size:, size:] = np.matmul(design.transpose(0, 2, 1), w_yh)
    weighted = np.matmul(weight, measured[:, :, None])
    linear = solve_normal_equations(normal, _project(weighted, factor, design))[:, :, 0]

    x, q = linear[:, :size], linear[:, size:]
    model = np.concatenate([x, n[:, None] * x + np.matmul(design, q[:, :, None])[:, :, 0]], axis=1)
    residual = measured - model
    weighted_residual = np.matmul(weight, residual[:, :, None])[:, :, 0]
    # The derivative of the model by n is (0, x).
    along = np.matmul(weight[:, :, size:], x[:, :, None])
    border = _project(along, factor, design)
    own = np.einsum("pi,pi->p", x, along[:, size:, 0])
    absorbed = np.einsum("pi,pi->p", border[:, :, 0], solve_normal_equations(normal, border)[:, :, 0])
    return _Optimum(
        linear=linear,
        chi2=np.einsum("pi,pi->p", residual, weighted_residual),
        gradient=np.einsum("pi,pi->p", x, weighted_residual[:, size:]),
        curvature=np.maximum(own - absorbed, 1e-15 * own),
        normal=normal,
        border=border[:, :, 0],
        own=own,
    )


def _project(weighted: Floats, factor: Floats, design: Floats) -> Floats:
    """The transposed derivative by (x, q) times a weighted vector."""
    size = design.shape[1]
    on_y = weighted[:, size:]
    return np.concatenate([weighted[:, :size] + factor * on_y, np.matmul(design.transpose(0, 2, 1), on_y)], axis=1)


def _full_information(optimum: _Optimum, size: int) -> Floats:
    """Information about (x, n, q) at the solution."""
    total = optimum.normal.shape[1] + 1
    full = np.empty((optimum.own.size, total, total))
    full[:, :-1, :-1] = optimum.normal
    full[:, -1, :-1] = full[:, :-1, -1] = optimum.border
    full[:, -1, -1] = optimum.own
    order = np.r_[0:size, total - 1, size : total - 1]
    return full[:, order][:, :, order]


def _invert(full: Floats, size: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Covariance, and whether the information left for (n, q) once x is free determines them."""
    scaled, unit = scale_to_unit_diagonal(full)
    head, side, tail = scaled[:, :size, :size], scaled[:, :size, size:], scaled[:, size:, size:]
    schur = tail - np.matmul(side.transpose(0, 2, 1), solve_normal_equations(head, side))
    smallest = np.linalg.eigvalsh(schur)[:, 0]
    is_identifiable = np.isfinite(smallest) & (smallest > SMALLEST_EIGENVALUE)
    covariance = np.full_like(full, np.nan)
    if np.any(is_identifiable):
        covariance[is_identifiable] = np.linalg.inv(scaled[is_identifiable])
    return covariance * unit[:, :, None] * unit[:, None, :], is_identifiable
