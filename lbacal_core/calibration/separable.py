"""A separable least-squares solver: a few non-linear numbers, everything else linear, many problems at once.

It knows no physics. Each problem has measured vectors x and y with their joint information matrix W, and the model

    y = (known + n F) x + H q,

x free, n and q a few numbers, F and H what each of them does along x. Given n the problem is linear in (x, q), so only
n is iterated (variable projection: Golub & Pereyra 1973, SIAM J. Numer. Anal. 10, 413). At the linear optimum the
derivative of chi^2 by n is the partial one, and the Schur complement of the information matrix is its curvature:
Newton's step is analytic. What is known of n beforehand, a mean and an error, is one more measured number.

Where the data determine x but not each of n and q, because two columns of (x, H) are nearly one (a flat chain), those
are told apart by a weak prior alone: each term n_i F_i x, H_j q_j is about as large as y at most. What they add
together is determined by the data, x does not depend on how it is shared, and `is_merged` says which they are.

The errors of x and y are correlated along y = -P x, where P is the abscissa at which a line is known best. At n F = -P
what is measured has nearly no error, and chi^2 has a narrow valley there, beside the broad one in which n is an amount
of something: Newton's step from a poor start leads into either. A single n of which nothing is known beforehand is
looked at along its whole range: where chi^2 is no parabola about the solution, is lower elsewhere, or the solution lies
nearer to -P than to 0, n is its mean over n >= 0, by its likelihood and the weak prior, with the standard deviation of
that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import Intercepts
from lbacal_core.linear import invert_symmetric, make_solver, scale_to_unit_diagonal, solve_symmetric

MAX_ITERATIONS = 50
STEP_TOLERANCE = 1e-5
"""Converged when n moves by less than this fraction of its standard deviation."""
SMALLEST_EIGENVALUE = 1e-11
"""Below this eigenvalue of the unit-diagonal information matrix of (n, q) the data do not determine them."""
WIDEST = 1.0
"""Standard deviation of the prior of a term n_i F_i x or H_j q_j about 0, in units of the mean of |y|."""
FARTHEST = 2.0
"""Standard deviations from the solution at which chi^2 is compared with the parabola."""
PARABOLA = (2.0, 8.0)
"""Growth of chi^2 there that still counts as that of a parabola, which grows by 4."""
RANGE = np.concatenate([[0.0], np.geomspace(2e-3, 3.0, 24)])
"""The n over which it is averaged, in units of the mean of |y|: one that is known to 0.2 % is known by a parabola."""
PROBES = np.array([0.1, 0.3, 1.0])
"""Amounts at which chi^2 is compared with the solution's."""
CERTAIN = 1e9
"""Information about an n that is held fixed, over that of the data."""
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
        Shape (problem, r).
    q
        Shape (problem, k).
    covariance
        Covariance of (x, n, q), shape (problem, m + r + k, m + r + k); NaN where not identifiable.
    chi2
        Shape (problem,); m - r - k degrees of freedom, and one more for each n of which something is known.
    is_converged, is_identifiable
        Shape (problem,).
    is_merged
        Which of (n, q) the data do not tell apart, shape (problem, r + k): all False, or at least two of them True.
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
        """Select some of the solutions."""
        return SeparableSolution(**{name: values[at] for name, values in vars(self).items()})

    def join(self, other: SeparableSolution) -> SeparableSolution:
        """Join the solutions with those of another."""
        pairs = zip(vars(self), vars(self).values(), vars(other).values(), strict=True)
        return SeparableSolution(**{name: np.concatenate(pair) for name, *pair in pairs})

    def exchange(self, at: NDArray[np.intp], part: SeparableSolution) -> SeparableSolution:
        """The solutions with those at some places exchanged."""
        fields = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(part).items():
            fields[name][at] = values
        return SeparableSolution(**fields)


def solve_separable(x: Floats, y: Floats, information: Floats, terms: Intercepts) -> SeparableSolution:
    """Minimise chi^2 over (x, n, q) for a batch of problems.

    Parameters
    ----------
    x, y
        Measured, shape (problem, m).
    information
        Inverse covariance of (x, y), shape (problem, 2 m, 2 m).
    terms
        F, H, and what is known of n, the same for all problems.
    """
    problem = _Scaled.of(x, y, information, terms)
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
    measured, weight
        (x, y) and information in these units, shape (problem, 2 m) and (problem, 2 m, 2 m).
    known, forms, design
        What multiplies x without n, F and H in these units, shape (problem, m), (problem, r, m) and (problem, m, k).
    mean, precision
        What is known of n, shape (problem, r).
    x_unit, y_unit, n_unit, q_unit
        Shape (problem, 1), (problem, 1), (problem, r) and (problem, k).
    """

    measured: Floats
    weight: Floats
    known: Floats
    forms: Floats
    design: Floats
    mean: Floats
    precision: Floats
    x_unit: Floats
    y_unit: Floats
    n_unit: Floats
    q_unit: Floats

    @classmethod
    def of(cls, x: Floats, y: Floats, information: Floats, terms: Intercepts) -> _Scaled:
        """Scale problems."""
        size = x.shape[1]
        x_unit, y_unit = _typical(x), _typical(y)
        n_unit = (y_unit / x_unit) / np.sqrt(np.mean(terms.front**2, axis=1))
        q_unit = y_unit / np.sqrt(np.mean(terms.behind**2, axis=1))
        unit = np.concatenate([np.repeat(x_unit, size, 1), np.repeat(y_unit, size, 1)], axis=1)
        return cls(
            np.concatenate([x / x_unit, y / y_unit], axis=1),
            information * unit[:, :, None] * unit[:, None, :],
            terms.known * (x_unit / y_unit),
            terms.front * (n_unit * (x_unit / y_unit))[:, :, None],
            terms.design * (q_unit / y_unit)[:, None, :],
            terms.mean / n_unit, terms.precision * n_unit**2,
            x_unit, y_unit, n_unit, q_unit,
        )  # fmt: skip

    def take(self, at: NDArray[np.intp]) -> _Scaled:
        """Some of the problems."""
        return _Scaled(**{name: values[at] for name, values in vars(self).items()})

    def before(self, n: Floats) -> Floats:
        """Coefficients of x, shape (..., problem, m)."""
        return np.asarray(self.known + np.matmul(n[..., None, :], self.forms)[..., 0, :])

    def solve(self, prior: float) -> SeparableSolution:
        """The solution in unit columns, with so much prior information about each of (n, q) being 0."""
        problems, size = self.measured.shape[0], self.design.shape[1]
        n = self._start()
        is_converged = np.zeros(problems, dtype=bool)
        optimum = part = _solve_linear(self, n, prior)
        moving, own = np.arange(problems), self
        for done in range(MAX_ITERATIONS):
            if done:
                part = _solve_linear(own, n[moving], prior)
                optimum.exchange(moving, part)
            step = solve_symmetric(part.curvature, part.gradient[:, :, None])[:, :, 0]
            # the length of the step in standard deviations of n
            length = np.einsum("pi,pij,pj->p", step, part.curvature, step)
            is_there = length <= STEP_TOLERANCE**2
            is_converged[moving] = is_there
            if np.all(is_there):
                break
            if np.any(is_there):
                moving, step = moving[~is_there], step[~is_there]
                own = self.take(moving)
            n[moving] += step
        is_converged &= np.isfinite(optimum.chi2)
        covariance, is_identifiable = _invert(_full_information(optimum, size), size)
        found = SeparableSolution(
            x=optimum.linear[:, :size],
            n=n,
            q=optimum.linear[:, size:],
            covariance=covariance,
            chi2=optimum.chi2,
            is_converged=is_converged,
            is_identifiable=is_identifiable,
            is_merged=np.zeros((problems, n.shape[1] + self.design.shape[2]), dtype=bool),
        )
        if n.shape[1] != 1 or np.any(self.precision):
            return found
        at = np.flatnonzero(self._is_doubtful(n, optimum, is_converged, prior))
        return found.exchange(at, self.take(at).average(prior)) if at.size else found

    def _is_doubtful(
        self, n: Floats, optimum: _Optimum, is_converged: NDArray[np.bool_], prior: float
    ) -> NDArray[np.bool_]:
        """Whether n may be elsewhere, shape (problem,): no parabola, a lower chi^2, or nearer to -P than to 0."""
        size = self.design.shape[1]
        at = np.arange(size)
        w_yx, w_yy = self.weight[:, size + at, at], self.weight[:, size + at, size + at]
        abscissa = w_yx.sum(axis=1) / np.maximum(w_yy.sum(axis=1), 1e-300)
        is_at_pole = self.before(n).mean(axis=1) < -abscissa / 2.0
        far = FARTHEST * optimum.curvature[:, 0] ** -0.5
        least = optimum.objective(n, prior)
        tried = np.stack([n - far, n + far, *_same(PROBES, len(n))])
        grown = _solve_linear(self, tried, prior).objective(tried, prior) - least
        low, high = PARABOLA
        is_least = np.all(grown[2:] >= 0.0, axis=0)
        is_parabola = np.all((low < grown[:2]) & (grown[:2] < high), axis=0)
        return np.asarray(~is_converged | is_at_pole | ~is_parabola | ~is_least)

    def average(self, prior: float) -> SeparableSolution:
        """The solution averaged over n >= 0, by its likelihood and the weak prior.

        Intercepts say the more of x the larger n: the error of x at one n is that at the smallest that the data allow.
        """
        problems, size = len(self.measured), self.design.shape[1]
        at = _same(RANGE, problems)
        optima = _solve_linear(self, at, prior)
        grown = optima.objective(at, max(prior, WIDEST**-2))
        grown -= grown.min(axis=0)
        weight = np.exp(-grown / 2.0) * np.gradient(RANGE)[:, None]
        weight /= weight.sum(axis=0)
        values = np.insert(optima.linear, size, at[:, :, 0], axis=2)
        mean = np.einsum("gp,gpi->pi", weight, values)
        between = (values - mean) * np.sqrt(weight)[:, :, None]
        smallest = RANGE[np.argmax(grown < FARTHEST**2, axis=0)]
        at_smallest = _solve_linear(self, smallest[:, None], prior)
        at_fixed_n = replace(at_smallest, own=at_smallest.own * CERTAIN)  # n known far better than the data know it
        within, is_identifiable = _invert(_full_information(at_fixed_n, size), size)
        return SeparableSolution(
            x=mean[:, :size],
            n=mean[:, size : size + 1],
            q=mean[:, size + 1 :],
            covariance=within + np.einsum("gpi,gpj->pij", between, between),
            chi2=optima.chi2.min(axis=0),
            is_converged=np.all(np.isfinite(grown), axis=0),
            is_identifiable=is_identifiable,
            is_merged=np.zeros((problems, 1 + self.design.shape[2]), dtype=bool),
        )

    def _start(self) -> Floats:
        """N of the weighted regression of y on x and H, as if x were without error; shape (problem, r)."""
        size, r = self.design.shape[1], self.forms.shape[1]
        x, y = self.measured[:, :size], self.measured[:, size:]
        columns = np.concatenate([x[:, :, None] * self.forms.transpose(0, 2, 1), self.design], axis=2)
        weighted = columns * np.einsum("pii->pi", self.weight[:, size:, size:])[:, :, None]
        normal = np.matmul(weighted.transpose(0, 2, 1), columns)
        target = np.matmul(weighted.transpose(0, 2, 1), (y - self.known * x)[:, :, None])
        at = np.arange(r)
        normal[:, at, at] += self.precision
        target[:, :r, 0] += self.precision * self.mean
        return solve_symmetric(normal, target)[:, :r, 0]

    def spread(self, solution: SeparableSolution) -> Floats:
        """Standard deviations of (n, q) in unit columns, shape (problem, r + k); NaN where not identifiable."""
        return np.asarray(np.sqrt(np.einsum("pii->pi", solution.covariance)[:, self.design.shape[1] :]))

    def unscale(self, solution: SeparableSolution) -> SeparableSolution:
        """The solution in the units of the problem."""
        back = np.concatenate([np.repeat(self.x_unit, self.design.shape[1], 1), self.n_unit, self.q_unit], axis=1)
        return replace(
            solution,
            x=solution.x * self.x_unit,
            n=solution.n * self.n_unit,
            q=solution.q * self.q_unit,
            covariance=solution.covariance * back[:, :, None] * back[:, None, :],
        )


def _same(values: Floats, problems: int) -> Floats:
    """Each of some n for all problems, shape (n, problem, 1)."""
    return np.repeat(values[:, None], problems, axis=1)[:, :, None]


def _typical(values: Floats) -> Floats:
    """Mean absolute value of each problem's vector, 1 where that is 0; shape (problem, 1)."""
    typical = np.abs(values).mean(axis=1, keepdims=True)
    return np.where(typical > 0, typical, 1.0)


@dataclass(frozen=True)
class _Optimum:
    """The linear optimum at one n: (x, q), m of them x; chi^2, and gradient and curvature of -chi^2 / 2 along n.

    All have the axes (..., problem) of n in front.
    """

    linear: Floats
    chi2: Floats
    gradient: Floats
    curvature: Floats
    normal: Floats
    border: Floats
    own: Floats
    size: int

    def objective(self, n: Floats, prior: float) -> Floats:
        """Chi^2 with the prior of (n, q), shape (..., problem)."""
        q = self.linear[..., self.size :]
        return np.asarray(self.chi2 + prior * (np.sum(n**2, axis=-1) + np.sum(q**2, axis=-1)))

    def exchange(self, at: NDArray[np.intp], part: _Optimum) -> None:
        """Exchange the optima of some problems."""
        for name, values in vars(part).items():
            if name != "size":
                getattr(self, name)[at] = values


def _solve_linear(problem: _Scaled, n: Floats, prior: float) -> _Optimum:
    """The linear optima at n, shape (..., problem, r)."""
    design, weight = problem.design, problem.weight
    size, constants = design.shape[1], design.shape[2]
    w_xx, w_xy = weight[:, :size, :size], weight[:, :size, size:]
    w_yx, w_yy = weight[:, size:, :size], weight[:, size:, size:]
    before = problem.before(n)
    row, column = before[..., :, None], before[..., None, :]
    # The derivative of the model by (x, q) is [[1, 0], [before, H]]; its normal matrix written out by blocks.
    w_yh = np.matmul(w_yy, design)
    side = np.matmul(w_xy, design) + row * w_yh
    normal = np.empty((*n.shape[:-1], size + constants, size + constants))
    normal[..., :size, :size] = w_xx + w_xy * column + row * (w_yx + w_yy * column)
    normal[..., :size, size:] = side
    normal[..., size:, :size] = np.swapaxes(side, -1, -2)
    normal[..., size:, size:] = np.matmul(np.swapaxes(design, -1, -2), w_yh) + prior * np.eye(constants)
    solve = make_solver(normal)
    weighted = np.matmul(weight, problem.measured[:, :, None])
    linear = solve(_project(weighted, row, design))[..., 0]

    x, q = linear[..., :size], linear[..., size:]
    model = np.concatenate([x, before * x + np.matmul(design, q[..., None])[..., 0]], axis=-1)
    residual = problem.measured - model
    weighted_residual = np.matmul(weight, residual[..., None])[..., 0]
    # The derivative of the model by n is (0, F x).
    terms = problem.forms * x[..., None, :]
    along = np.matmul(weight[:, :, size:], np.swapaxes(terms, -1, -2))
    border = _project(along, row, design)
    known = problem.precision * (n - problem.mean)
    own = np.matmul(terms, along[..., size:, :]) + np.einsum(
        "pr,rs->prs", problem.precision + prior, np.eye(n.shape[-1])
    )
    curvature = own - np.matmul(np.swapaxes(border, -1, -2), solve(border))
    at = np.arange(n.shape[-1])
    curvature[..., at, at] = np.maximum(curvature[..., at, at], 1e-15 * own[..., at, at])
    return _Optimum(
        linear=linear,
        chi2=np.einsum("...i,...i->...", residual, weighted_residual) + np.sum(known * (n - problem.mean), axis=-1),
        gradient=np.matmul(terms, weighted_residual[..., size:, None])[..., 0] - prior * n - known,
        curvature=curvature,
        normal=normal,
        border=border,
        own=own,
        size=size,
    )


def _project(weighted: Floats, row: Floats, design: Floats) -> Floats:
    """The transposed derivative by (x, q) times weighted vectors."""
    size = design.shape[1]
    on_y = weighted[..., size:, :]
    on_x = weighted[..., :size, :] + row * on_y
    on_q = np.matmul(np.swapaxes(design, -1, -2), on_y)
    return np.concatenate([on_x, np.broadcast_to(on_q, (*on_x.shape[:-2], *on_q.shape[-2:]))], axis=-2)


def _full_information(optimum: _Optimum, size: int) -> Floats:
    """Information about (x, n, q) at the solution."""
    linear, r = optimum.normal.shape[1], optimum.own.shape[1]
    full = np.empty((len(optimum.own), linear + r, linear + r))
    full[:, :linear, :linear] = optimum.normal
    full[:, :linear, linear:] = optimum.border
    full[:, linear:, :linear] = optimum.border.transpose(0, 2, 1)
    full[:, linear:, linear:] = optimum.own
    order = np.r_[0:size, linear : linear + r, size:linear]
    return full[:, order][:, :, order]


def _invert(full: Floats, size: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Covariance, and whether the information left for (n, q) once x is free determines them."""
    scaled, unit = scale_to_unit_diagonal(full)
    head, side, tail = scaled[:, :size, :size], scaled[:, :size, size:], scaled[:, size:, size:]
    schur = tail - np.matmul(side.transpose(0, 2, 1), solve_symmetric(head, side))
    smallest = np.linalg.eigvalsh(schur)[:, 0]
    is_identifiable = np.isfinite(smallest) & (smallest > SMALLEST_EIGENVALUE)
    covariance = np.full_like(full, np.nan)
    if np.any(is_identifiable):
        covariance[is_identifiable] = invert_symmetric(scaled[is_identifiable])
    return covariance * unit[:, :, None] * unit[:, None, :], is_identifiable
