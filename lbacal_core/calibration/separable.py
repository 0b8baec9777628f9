"""A separable least-squares solver: one non-linear number, everything else linear, many problems at once.

It knows no physics. Each problem has measured vectors x and y with their joint information matrix W, and the model

    y = n x + H q,

x free, q a few numbers, n one number. Given n the problem is linear in (x, q), so only n is iterated (variable
projection: Golub & Pereyra 1973, SIAM J. Numer. Anal. 10, 413). At the linear optimum the derivative of chi^2 by n is
the partial one, and the Schur complement of the information matrix is its curvature: Newton's step is analytic.

Where the data determine x but not each of n and q, because two columns of (x, H) are nearly one (a flat chain), those
are told apart by a weak prior alone: each term n x, H_j q_j is about as large as y at most. What they add together is
determined by the data, x does not depend on how it is shared, and `is_merged` says which they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.normal_equations import scale_to_unit_diagonal, solve_normal_equations
from lbacal_core.grids import Floats

MAX_ITERATIONS = 50
STEP_TOLERANCE = 1e-5
"""Converged when n moves by less than this fraction of its standard deviation."""
SMALLEST_EIGENVALUE = 1e-11
"""Below this eigenvalue of the unit-diagonal information matrix of (n, q) the data do not determine them."""
WIDEST = 1.0
"""Standard deviation of the prior of a term n x or H_j q_j about 0, in units of the mean of |y|."""
MERGED_FROM = 0.5
"""Data that leave a term less certain than this, in the same unit, do not tell it apart from others."""


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
    is_merged
        Which of (n, q) the data do not tell apart, shape (problem, 1 + k): all False, or at least two of them True.
    """

    x: Floats
    n: Floats
    q: Floats
    covariance: Floats
    chi2: Floats
    is_converged: NDArray[np.bool_]
    is_identifiable: NDArray[np.bool_]
    is_merged: NDArray[np.bool_]

    def take(self, at: NDArray[Any]) -> SeparableSolution:
        """Some of the solutions."""
        return SeparableSolution(**{name: values[at] for name, values in vars(self).items()})

    def exchange(self, at: NDArray[np.intp], part: SeparableSolution) -> SeparableSolution:
        """The solutions with those at some places exchanged."""
        fields = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(part).items():
            fields[name][at] = values
        return SeparableSolution(**fields)


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
    problem = _Scaled.of(x, y, information, design)
    solution = problem.solve(0.0)
    at = np.flatnonzero(~(problem.spread(solution).max(axis=1) <= MERGED_FROM))
    if at.size == 0:
        return problem.unscale(solution)
    # A term by itself may be as uncertain as the prior leaves it: only two or more can stand for each other.
    narrowed = problem.take(at).solve(WIDEST**-2)
    is_merged = problem.take(at).spread(narrowed) > MERGED_FROM
    has_merged = np.isfinite(narrowed.covariance[:, 0, 0]) & (is_merged.sum(axis=1) > 1)
    exchanged = replace(narrowed, is_merged=is_merged).take(has_merged)
    return problem.unscale(solution.exchange(at[has_merged], exchanged))


@dataclass(frozen=True)
class _Scaled:
    """Problems with unit columns: n and q may differ from x by many orders of magnitude.

    Attributes
    ----------
    measured, weight, design
        (x, y), information and H in these units, shape (problem, 2 m), (problem, 2 m, 2 m) and (problem, m, k).
    x_unit, y_unit, q_unit
        Shape (problem, 1), (problem, 1) and (problem, k).
    """

    measured: Floats
    weight: Floats
    design: Floats
    x_unit: Floats
    y_unit: Floats
    q_unit: Floats

    @classmethod
    def of(cls, x: Floats, y: Floats, information: Floats, design: Floats) -> _Scaled:
        """Scale problems."""
        size = x.shape[1]
        x_unit, y_unit = _typical(x), _typical(y)
        q_unit = y_unit / np.sqrt(np.mean(design**2, axis=0))
        unit = np.concatenate([np.repeat(x_unit, size, 1), np.repeat(y_unit, size, 1)], axis=1)
        return cls(
            np.concatenate([x / x_unit, y / y_unit], axis=1),
            information * unit[:, :, None] * unit[:, None, :],
            design * (q_unit / y_unit)[:, None, :],
            x_unit, y_unit, q_unit,
        )  # fmt: skip

    def take(self, at: NDArray[np.intp]) -> _Scaled:
        """Some of the problems."""
        return _Scaled(**{name: values[at] for name, values in vars(self).items()})

    def solve(self, prior: float) -> SeparableSolution:
        """The solution in unit columns, with so much prior information about each of (n, q) being 0."""
        problems, size = self.measured.shape[0], self.design.shape[1]
        own = np.einsum("pii->pi", self.weight[:, size:, size:])
        n = _start(self.measured[:, :size], self.measured[:, size:], own, self.design)
        is_converged = np.zeros(problems, dtype=bool)
        for _ in range(MAX_ITERATIONS):
            optimum = _solve_linear(n, self.design, self.weight, self.measured, prior)
            has_curvature = optimum.curvature > 0
            step = np.divide(optimum.gradient, optimum.curvature, out=np.zeros(problems), where=has_curvature)
            is_converged |= np.abs(step) * np.sqrt(optimum.curvature) <= STEP_TOLERANCE
            if np.all(is_converged):
                break
            n = np.where(is_converged, n, n + step)
        is_converged &= np.isfinite(optimum.chi2)
        covariance, is_identifiable = _invert(_full_information(optimum, size), size)
        return SeparableSolution(
            x=optimum.linear[:, :size],
            n=n,
            q=optimum.linear[:, size:],
            covariance=covariance,
            chi2=optimum.chi2,
            is_converged=is_converged,
            is_identifiable=is_identifiable,
            is_merged=np.zeros((problems, 1 + self.design.shape[2]), dtype=bool),
        )

    def spread(self, solution: SeparableSolution) -> Floats:
        """Standard deviations of (n, q) in unit columns, shape (problem, 1 + k); NaN where not identifiable."""
        return np.asarray(np.sqrt(np.einsum("pii->pi", solution.covariance)[:, self.design.shape[1] :]))

    def unscale(self, solution: SeparableSolution) -> SeparableSolution:
        """The solution in the units of the problem."""
        back = np.concatenate(
            [np.repeat(self.x_unit, self.design.shape[1], 1), self.y_unit / self.x_unit, self.q_unit], axis=1
        )
        return replace(
            solution,
            x=solution.x * self.x_unit,
            n=solution.n * (self.y_unit / self.x_unit)[:, 0],
            q=solution.q * self.q_unit,
            covariance=solution.covariance * back[:, :, None] * back[:, None, :],
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


def _solve_linear(n: Floats, design: Floats, weight: Floats, measured: Floats, prior: float) -> _Optimum:
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
    normal[:, size:, size:] = np.matmul(design.transpose(0, 2, 1), w_yh) + prior * np.eye(design.shape[2])
    weighted = np.matmul(weight, measured[:, :, None])
    linear = solve_normal_equations(normal, _project(weighted, factor, design))[:, :, 0]

    x, q = linear[:, :size], linear[:, size:]
    model = np.concatenate([x, n[:, None] * x + np.matmul(design, q[:, :, None])[:, :, 0]], axis=1)
    residual = measured - model
    weighted_residual = np.matmul(weight, residual[:, :, None])[:, :, 0]
    # The derivative of the model by n is (0, x).
    along = np.matmul(weight[:, :, size:], x[:, :, None])
    border = _project(along, factor, design)
    own = np.einsum("pi,pi->p", x, along[:, size:, 0]) + prior
    absorbed = np.einsum("pi,pi->p", border[:, :, 0], solve_normal_equations(normal, border)[:, :, 0])
    return _Optimum(
        linear=linear,
        chi2=np.einsum("pi,pi->p", residual, weighted_residual),
        gradient=np.einsum("pi,pi->p", x, weighted_residual[:, size:]) - prior * n,
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
