"""One chain through the years: the lines of a path in several windows, fitted together.

A window by itself knows the share of the electronic noise in its power to one or two percent, and the level of the
power to 0.2 %. While the hardware is the same, the noise constants and the shape of A(nu) are the same in all windows;
what differs is a gain in front of N_RCU, with a tilt and a curvature along frequency (`gain_modes`):

    s_k = s exp(phi g_k),    b_k = N_LNA s_k + N_RCU S G_RCU + N_ADC,    g_k ~ N(0, T),

where s is that of the window itself. With g_k integrated out, the lines of another window are a measurement of (s, b)
with the covariance C_k + D_k T D_k^T, D_k the derivative of its lines by g_k. Such measurements add, and the chain is
solved once, for their sum. All is linear but exp(phi g_k), and repeated from the g_k that were found. T is wide: levels
are known so well that a closer one does not change C of steady years (docs/decisions/years.md). Where something
changed between, each noise constant is another by a factor of its own, with a prior, and the gain has a wider one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from lbacal_core.calibration.chain_test import is_improbable
from lbacal_core.calibration.channels import Booleans, solve_without_interference
from lbacal_core.calibration.lines import Lines, NoiseLevels, SharedNoise, continue_lines
from lbacal_core.calibration.paths import Paths
from lbacal_core.calibration.separable import SeparableSolution
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.curves.curves import Repeated
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, Owner
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import Intercepts
from lbacal_core.linear import invert_symmetric, solve_symmetric

MOST_ROUNDS, SMALLEST_STEP = 20, 1e-4
"""Gains of a year move by a few percent and take three rounds, a tenth of the power up to 17."""
GAIN_SIGMAS, OTHER_SIGMAS = (0.3, 0.03, 0.03), (1.0, 0.5, 0.1)
"""Standard deviations of ln of the gain between two windows, and of its tilt and curvature at the band's end; where the
hardware is another, which may have a cable that nobody entered (80 m in place of 50 m: -0.76, -0.18, 0.01)."""
OTHER_NOISE = read_prior()["other_noise"].size
"""Standard deviation of ln of each noise constant where the hardware is another."""
FARTHEST = 5.0
"""Standard deviations beyond which a gain is no gain: a path that is dead in one of two windows (1e-4 of the power)."""


@dataclass(frozen=True)
class Beside:
    """The lines of a fit of another window.

    Attributes
    ----------
    lines
        The lines of some paths of one polarisation, or of a mean.
    is_same
        Whether a path had the same hardware then, shape (path,).
    """

    lines: KeptLines
    is_same: NDArray[np.bool_]


@dataclass(frozen=True)
class Together:
    """The chain of some paths, fitted to several windows.

    Attributes
    ----------
    solution, is_free
        What `solve_without_interference` gives, in the gain of the window itself.
    windows
        How many were fitted together, shape (path,); 1 where they do not repeat.
    chi2_per_dof
        The lines of all windows against one chain, shape (path,); NaN where there is one window.
    """

    solution: SeparableSolution
    is_free: Booleans
    windows: NDArray[np.int64]
    chi2_per_dof: Floats

    def describe(self, path: int) -> Repeated | None:
        """How a path repeats; None where there is one window."""
        chi2_per_dof = float(self.chi2_per_dof[path])
        return None if np.isnan(chi2_per_dof) else Repeated(int(self.windows[path]), chi2_per_dof)


def solve_together(
    lines: Lines,
    owners: Sequence[Owner],
    loss: Floats,
    terms: Intercepts,
    beside: Sequence[Beside],
    frequency_mhz: Floats,
    alone: SeparableSolution,
    is_free: Booleans,
    is_small: NDArray[np.bool_],
) -> Together:
    """Fit the chain to the lines of some paths in a window and in others.

    Parameters
    ----------
    loss
        L_coax of each path in the window, shape (path, freq).
    beside
        The other windows. Where a path does not repeat, beyond chance, the ones with its hardware count, or none.
    alone, is_free
        The solution by the window alone; of paths that are too small for one, that of the window that lends to them.
    is_small
        Which paths are too small: the lines of all windows count for them, whatever changed between.
    """
    windows, chi2_per_dof = np.ones(len(owners), dtype=np.int64), np.full(len(owners), np.nan)
    joined, is_free, shapes = alone, is_free.copy(), gain_modes(frequency_mhz)
    every = [_line_up(one, owners, loss) for one in beside]
    # without the lines that a change parts from this window
    same = [replace(one, information=one.information * one.is_same[:, None, None]) for one in every]
    is_parted = _count(every, len(owners)) > _count(same, len(owners))
    for counted, is_asked in ((every, np.ones_like(is_parted)), (same, is_parted)):
        count = _count(counted, len(owners))
        at = np.flatnonzero(is_asked & (count > 0) & (windows == 1))
        if at.size == 0:
            continue
        others = [one.take(at) for one in counted if np.any(one.has_lines[at])]
        solution, free, chi2, is_settled = _solve(lines.select(at), others, alone.take(at), terms, shapes)
        dof = count[at] * (lines.information.shape[1] - len(GAIN_SIGMAS))
        # what a small window borrows is never quite its own: where that shows, its error grows with it
        excess = np.where(is_small[at], np.maximum(chi2 / dof, 1.0), 1.0)
        solution = replace(solution, covariance=solution.covariance * excess[:, None, None])
        is_joined = is_settled & solution.is_converged & solution.is_identifiable
        is_joined &= is_small[at] | ~is_improbable(chi2, dof)
        # that windows differ where something changed is no news
        is_news = ~is_parted[at] | (counted is same)
        chi2_per_dof[at] = np.where(is_joined | is_news, chi2 / dof, np.nan)
        at = at[is_joined]
        windows[at] += count[at]
        is_free[at] = free[is_joined]
        joined = joined.exchange(at, solution.take(is_joined))
    return Together(joined, is_free, windows, chi2_per_dof)


def _count(others: Sequence[_Other], paths: int) -> NDArray[np.int64]:
    """How many windows have lines of each path, shape (path,)."""
    return np.sum([one.has_lines for one in others], axis=0, dtype=np.int64) * np.ones(paths, dtype=np.int64)


def _solve(
    lines: Lines, others: Sequence[_Other], solution: SeparableSolution, terms: Intercepts, shapes: Floats
) -> tuple[SeparableSolution, Booleans, Floats, NDArray[np.bool_]]:
    """The solution, which intercepts are free, chi^2 of all lines against one a channel, and whether gains settle."""
    own = np.concatenate([lines.slope, lines.intercept], axis=1)
    gains = [np.zeros_like(one.sigmas) for one in others]
    limits = [FARTHEST * one.sigmas for one in others]
    taken = [solution.q]
    given: list[Floats] = []
    for _ in range(MOST_ROUNDS):
        behind = taken[-1] @ terms.behind
        parts = [
            _integrate(one, gain, solution, behind, terms, shapes) for one, gain in zip(others, gains, strict=True)
        ]
        together = [(own, lines.information), *((one.measured, one.information) for one in parts)]
        information = np.sum([weight for _, weight in together], axis=0)
        weighted = np.sum([weight @ measured[:, :, None] for measured, weight in together], axis=0)
        mean = solve_symmetric(information, weighted)[:, :, 0]
        slope, intercept = np.split(mean, 2, axis=1)
        solution, is_free = solve_without_interference(slope, intercept, information, terms)
        model = np.concatenate([solution.x, terms.on_line(solution.x, solution.n, solution.q)], axis=1)
        found = [np.einsum("pmi,pi->pm", one.along, one.measured - model) for one in parts]
        before, gains = gains, [np.clip(one, -most, most) for one, most in zip(found, limits, strict=True)]
        if np.max(step := np.max(np.abs(np.subtract(gains, before)), axis=(0, 2))) < SMALLEST_STEP:
            break
        given.append(solution.q)
        taken.append(_extrapolate(taken, given))
    is_settled = (step < SMALLEST_STEP) & np.all(np.abs(gains) < limits, axis=(0, 2))
    left = [np.einsum("pi,pij,pj->p", one - mean, weight, one - mean) for one, weight in together]
    return solution, is_free, np.sum(left, axis=0), is_settled


def _extrapolate(taken: Sequence[Floats], given: Sequence[Floats]) -> Floats:
    """Where rounds that took some noise and gave another would give what they take, by the last three (Anderson 1965).

    The noise behind the gain weighs 1 - 1 / factor in what a round gives: at half the gain rounds by themselves swing,
    at a tenth they creep.
    """
    last = np.array(given[-3:])
    left = last - np.array(taken[-len(last) :])
    changes = np.moveaxis(np.diff(left, axis=0), 0, -1)
    along = np.swapaxes(changes, -1, -2)
    weight = solve_symmetric(along @ changes, along @ left[-1][:, :, None])
    return np.asarray(last[-1] - (np.moveaxis(np.diff(last, axis=0), 0, -1) @ weight)[:, :, 0])


def pick_beside(beside: Sequence[Beside], owner: Owner) -> list[Beside]:
    """Select the windows of the station and dipole of a path, or of a mean."""
    return [one for one in beside if one.lines.owners[0][::2] == owner[::2]]


def weigh_by_members(beside: Sequence[Beside], members: MemberLines | None, events: int) -> tuple[list[Beside], float]:
    """The windows of a mean and the window itself, each with the information that it has.

    Who is away has its lines from another window, times what the members of both gained since (`join_away`): with the
    share w of the mean its error is w times the error of the ratio of the two groups then. Another window differs from
    this one by the errors of the members that both have; what the lines of this window do not account for is its own.

    Parameters
    ----------
    members
        Those of the window itself; None where paths are single ones.
    events
        How many the window itself has.

    Returns
    -------
    The windows that have a member in common, the information of their lines changed, and the factor of that of the
    lines of the window itself.
    """
    if members is None:
        return list(beside), 1.0
    lent, own = 0.0, members.variance_of(members.present) / events
    power = dict(zip(members.names, members.slope.sum(axis=1).tolist(), strict=True))
    away, others = power.keys() - members.present, list[tuple[Beside, float, float]]()
    for one in beside:
        there, count = one.lines.members, int(one.lines.events[0])
        common = set() if there is None else members.present & there.present
        if there is None or not common:
            continue
        of_both = members.variance_of(common) / events, there.variance_of(common) / count
        if here := away & there.present:
            share = sum(power[name] for name in here) / sum(power.values())
            lent += share**2 * (of_both[0] - own + of_both[1] + there.variance_of(here) / count)
            away -= here
        others.append((one, sum(of_both), there.variance_of(there.present) / count))
    found = []
    for one, between, its in others:
        share = its / max(between - own - lent, its)
        found.append(replace(one, lines=replace(one.lines, information=share * one.lines.information)))
    return found, own / (own + lent)


def gain_modes(frequency_mhz: Floats) -> Floats:
    """A gain that is flat along frequency, tilted and curved: the Legendre polynomials 0 to 2 over the band.

    Returns
    -------
    Shape (3, freq); at the highest channel all are 1.
    """
    low, high = frequency_mhz[0], frequency_mhz[-1]
    return np.asarray(legendre.legvander((2.0 * frequency_mhz - low - high) / (high - low), len(GAIN_SIGMAS) - 1).T)


@dataclass(frozen=True)
class _Other:
    """The lines of another window on the paths of this one; no information where there are none.

    Shapes (path, 2 freq), (path, 2 freq, 2 freq), (path, freq) and (path,): `cable` is the loss of then over that of
    now, `is_same` whether nothing changed between.
    """

    measured: Floats
    information: Floats
    cable: Floats
    is_same: NDArray[np.bool_]

    @property
    def sigmas(self) -> Floats:
        """Standard deviations of the gain between the windows, shape (path, shape)."""
        return np.where(self.is_same[:, None], GAIN_SIGMAS, OTHER_SIGMAS)

    @property
    def has_lines(self) -> NDArray[np.bool_]:
        return np.asarray(np.any(self.information, axis=(1, 2)))

    def take(self, at: NDArray[np.intp]) -> _Other:
        return _Other(*(values[at] for values in vars(self).values()))


def _line_up(one: Beside, owners: Sequence[Owner], loss: Floats) -> _Other:
    """The lines of another window that count, in the order of the owners."""
    kept, (paths, channels) = one.lines, loss.shape
    place = {owner: k for k, owner in enumerate(kept.owners) if kept.is_good[k]}
    at = [k for k, owner in enumerate(owners) if owner in place]
    of = [place[owners[k]] for k in at]
    found = _Other(
        np.zeros((paths, 2 * channels)), np.zeros((paths, 2 * channels, 2 * channels)), np.ones_like(loss),
        np.ones(paths, dtype=bool),
    )  # fmt: skip
    found.measured[at] = np.concatenate([kept.slope[of], kept.intercept[of]], axis=1)
    found.information[at] = kept.information[of]
    found.cable[at] = kept.loss[of] / loss[at]
    found.is_same[at] = one.is_same[of]
    return found


@dataclass(frozen=True)
class _Measurement:
    """The lines of a window as a measurement of (s, b) of another, the gain between them integrated out.

    `along` takes what they depart from (s, b) to the most probable gain, shape (path, shape, 2 freq).
    """

    measured: Floats
    information: Floats
    along: Floats


def _integrate(
    other: _Other, gain: Floats, solution: SeparableSolution, behind: Floats, terms: Intercepts, shapes: Floats
) -> _Measurement:
    factor = other.cable * np.exp(gain @ shapes)
    # in b_k only what is in front of N_RCU has the gain; of the rest the last round's is taken off, and no bias is left
    without_gain = np.concatenate([np.zeros_like(factor), (1.0 - factor) * behind], axis=1)
    both = np.concatenate([factor, factor], axis=1)
    information = other.information * both[:, :, None] * both[:, None, :]
    moved = solution.x[:, :, None] * shapes.T
    derivative = np.concatenate([moved, terms.before(solution.n)[:, :, None] * moved], axis=1)
    measured = (other.measured - without_gain) / both + np.einsum("pim,pm->pi", derivative, gain)
    front, back = solution.n[:, :, None] * terms.front * solution.x[:, None], solution.q[:, :, None] * terms.behind
    noise = np.concatenate([front, back / factor[:, None]], axis=1).transpose(0, 2, 1)
    noise = np.concatenate([np.zeros_like(noise), noise], axis=1)
    # in units of their standard deviations, of which that of what is the same is 0
    of_noise = noise * (OTHER_NOISE * ~other.is_same[:, None, None])
    derivative = np.concatenate([derivative * other.sigmas[:, None], of_noise], axis=2)
    weighted = information @ derivative
    left = invert_symmetric(np.eye(derivative.shape[2]) + derivative.transpose(0, 2, 1) @ weighted)
    along = left @ weighted.transpose(0, 2, 1)
    of_gain = other.sigmas[:, :, None] * along[:, : len(shapes)]
    return _Measurement(measured, information - weighted @ along, of_gain)


# A window too small for a fit: its lines have the noise levels of the nearest window that has a curve.


@dataclass(frozen=True)
class Lent:
    """Lines of another window for paths that are too small for a fit.

    Attributes
    ----------
    at
        Which paths, shape (lent,).
    lines
        Those of their own events, with the noise levels of then.
    start
        The chain of then.
    """

    at: NDArray[np.intp]
    lines: Lines
    start: SeparableSolution

    def insert_into(
        self, at: NDArray[np.intp], alone: SeparableSolution, is_free: Booleans
    ) -> tuple[NDArray[np.intp], tuple[SeparableSolution, Booleans]]:
        """Insert small paths among the fitted ones; returns all paths in order, their solution and free intercepts.

        `at` and `is_free` are those of the fitted paths, shapes (path,) and (path, freq).
        """
        both = np.concatenate([at, self.at])
        order = np.argsort(both)
        free = np.concatenate([is_free, np.zeros(self.lines.slope.shape, dtype=bool)])
        return both[order], (alone.join(self.start).take(order), free[order])


def lend(
    beside: Sequence[Beside], is_small: NDArray[np.bool_], paths: Paths, sky: Floats, loss: Floats, terms: Intercepts
) -> Iterator[Lent]:
    """Take noise levels and chain from the nearest window that has its own, for each path with too few events.

    None where no window has any.

    Parameters
    ----------
    sky
        P_sky, shape (event, freq).
        is_small
            Which paths have too few events, shape (path,).
        loss
            L_coax of each path, shape (path, freq).
    """
    lacks = is_small.copy()
    for one in beside:
        # what a window has borrowed it lends to nobody: C would depend on which of two small windows was fitted first
        own = {one.lines.owners[k] for k in np.flatnonzero(one.lines.events >= MIN_EVENTS).tolist()}
        has_own = np.array([owner in own for owner in paths.owners])
        at = np.flatnonzero(lacks & has_own & _line_up(one, paths.owners, loss).has_lines)
        if at.size:
            lacks[at] = False
            of = np.array([list(one.lines.owners).index(paths.owners[k]) for k in at])
            lines = lines_of(one.lines, of)
            start, _ = solve_without_interference(lines.slope, lines.intercept, lines.information, terms)
            x = start.x * loss[at] / one.lines.loss[of]
            start = replace(start, x=x * _find_gain(paths, at, sky, replace(start, x=x), terms))
            then = replace(
                lines, slope=start.x, intercept=terms.on_line(start.x, start.n, start.q),
                information=np.zeros_like(lines.information),
            )  # fmt: skip
            yield Lent(at, continue_lines(then, paths.power[at], sky, paths.relative_variance[at]), start)


def _find_gain(paths: Paths, at: NDArray[np.intp], sky: Floats, chain: SeparableSolution, terms: Intercepts) -> Floats:
    """By how much the power in front of N_RCU exceeds that of a chain, shape (path, 1), at the median channel.

    Noise levels are shares of the power: at four times the power those of a chain are a quarter. 1 for a dead path.
    """
    is_there = np.isfinite(paths.relative_variance[at])[:, :, None]
    front = (chain.x * terms.before(chain.n))[:, None] + chain.x[:, None] * sky
    left = np.where(is_there, paths.power[at] - (chain.q @ terms.behind)[:, None], 0.0).sum(axis=1)
    gain = np.median(left / np.maximum(np.where(is_there, front, 0.0).sum(axis=1), 1e-300), axis=1, keepdims=True)
    return np.where(gain > np.exp(-FARTHEST), gain, 1.0)


def lines_of(kept: KeptLines, at: NDArray[np.intp]) -> Lines:
    """The lines of some paths. Where an event shares nothing along frequency both of its vectors are 0."""
    shared = SharedNoise(kept.constant[at], kept.behind[at])
    levels = NoiseLevels(kept.radiometer[at], np.hypot(shared.constant, shared.behind))
    return Lines(kept.slope[at], kept.intercept[at], kept.information[at], levels, shared)
