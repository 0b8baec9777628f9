"""The model extended by causes: all parameters fitted again, not linearised, and the gain on data not used.

The recorded power is divided by what the causes do to it, the chain is fitted again, and the sizes move by
Newton's step until nothing changes: the joint maximum of the likelihood of chain and causes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.terms import Cause, ChainTerms, Law, signature
from lbacal_core.discovery.baseline import Baseline, StationData, fit_baseline
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.targets import Target
from lbacal_core.discovery.whitening import Residuals, split_residuals
from lbacal_core.grids import Floats

MAX_ROUNDS = 8
LARGEST_CHANGE = 50.0
"""Factor on the power beyond which a fit has run away."""
SMALLEST_DIFFERENCE = 1e-3
"""Of signatures that are fitted together: 1 - r^2 of one against the others."""
DATE_BLOCKS, LST_BLOCKS, FOLDS = 8, 12, 4


@dataclass(frozen=True)
class Effect:
    """A cause under a law for a target, at a size.

    Attributes
    ----------
    sigma
        Standard deviation of the size under the law.
    law_sigma
        Scatter of the size among the laws that the data leave open, as a fraction of the size.
    """

    cause: Cause
    law: Law
    target: Target
    size: float
    sigma: float = np.inf
    law_sigma: float = 0.0

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the size, the law not being known either."""
        return float(np.hypot(self.sigma, self.law_sigma * self.size))


@dataclass(frozen=True)
class Extension:
    """The chain and the effects fitted together, and the evidence that is left."""

    effects: list[Effect]
    baseline: Baseline
    evidence: Evidence
    is_converged: bool

    @property
    def residuals(self) -> Residuals:
        """What is left, with its noise levels."""
        return self.evidence.residuals


def fit_plain(data: StationData, modes: Floats | None = None) -> Extension:
    """The chain of every path fitted without any effect."""
    baseline = fit_baseline(data)
    return Extension(
        [], baseline, Evidence(data, split_residuals(data, baseline.residual), baseline.terms, modes), True
    )


def _can_be_told_apart(information: Floats) -> bool:
    """Whether every effect is seen, and none is a mixture of the others."""
    seen = np.diag(information)
    if not np.all(np.isfinite(information)) or np.any(seen <= 0):
        return False
    size = np.sqrt(seen)
    return bool(np.linalg.eigvalsh(information / np.outer(size, size))[0] > SMALLEST_DIFFERENCE)


def power_ratio(data: StationData, terms: ChainTerms, effects: Sequence[Effect]) -> Floats:
    """Power with the effects over power without, shape (path, event, freq)."""
    plain = terms.power()
    ratio = np.empty_like(data.power)
    for members, index, concerned in _groups(data, effects):
        changed = terms
        for effect in (effects[k] for k in concerned):
            changed = effect.cause.apply(changed, data.conditions, effect.law, effect.size)
        ratio[members] = np.maximum(changed.power()[index] / plain[index], 1e-3)
    return ratio


def _groups(data: StationData, effects: Sequence[Effect]) -> list[tuple[NDArray[np.int64], int, list[int]]]:
    """Paths of the same class that the same effects concern: members, class, effects."""
    columns = [data.class_of, *(effect.target.is_member.astype(int) for effect in effects)]
    keys, group_of = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)
    return [
        (np.flatnonzero(group_of.ravel() == g), int(key[0]), np.flatnonzero(key[1:]).tolist())
        for g, key in enumerate(keys)
    ]


def fit_extension(data: StationData, before: Extension, new: Effect, modes: Floats | None = None) -> Extension | None:
    """Fit the chain of every path and the sizes of all effects together, those of the model before and a new one.

    None where data cannot tell them apart, or where the fit runs away.

    Parameters
    ----------
    before
        The model that is extended.
    new
        The effect added, at the size from which to start.
    modes
        Relative changes of P_sky by which sky and antenna models differ, shape (mode, class, event, freq), or None.
    """
    most = new.cause.largest_step
    effects = [*before.effects, replace(new, size=float(np.clip(new.size, -most, most)))]
    limit = np.array([effect.cause.largest_step for effect in effects])
    baseline = before.baseline
    for _ in range(MAX_ROUNDS):
        ratio = power_ratio(data, baseline.terms, effects)
        if not np.all((ratio > LARGEST_CHANGE**-1) & (ratio < LARGEST_CHANGE)):
            return None
        baseline = fit_baseline(data, ratio)
        evidence = Evidence(data, split_residuals(data, baseline.residual), baseline.terms, modes)
        # The weights stay those of the model before until the sizes stand still: they only weigh.
        weighed = evidence.with_levels(before.residuals.levels)
        signatures = [signature(e.cause, baseline.terms, data.conditions, e.law, e.size) for e in effects]
        score, information = weighed.products(signatures, [effect.target for effect in effects])
        if not _can_be_told_apart(information):
            return None
        step = np.linalg.solve(information, score)
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        step = np.clip(step, -limit, limit)
        is_converged = bool(np.all(np.abs(step) < 0.02 * sigma))
        fitted = [replace(effect, sigma=float(s)) for effect, s in zip(effects, sigma, strict=True)]
        if is_converged:
            break
        effects = [replace(effect, size=effect.size + float(d)) for effect, d in zip(fitted, step, strict=True)]
    return Extension(fitted, baseline, evidence, is_converged)


def held_out_fold(data: StationData) -> NDArray[np.int64]:
    """Fold of each event: blocks of date and of 2 h of LST, because neighbouring events share conditions."""
    order = np.argsort(np.argsort(data.conditions.time_unix))
    date_block = order * DATE_BLOCKS // order.size
    lst_block = (data.conditions.lst_hours // (24 / LST_BLOCKS)).astype(int)
    return np.asarray((date_block + lst_block) % FOLDS)


def held_out_gain(before: Extension, effect: Effect, laws: Sequence[Law]) -> tuple[float, int]:
    """Gain in log-likelihood on events not used, and their number.

    In each of the folds the law (a date, hours, a delay) is chosen again and the size fitted on the other folds.
    """
    data = before.evidence.data
    fold = held_out_fold(data)
    rows = [by_event(before, replace(effect, law=law)) for law in laws]
    score, information = (np.stack(part) for part in zip(*rows, strict=True))
    gain = 0.0
    for k in range(FOLDS):
        is_test = fold == k
        s, f = score[:, ~is_test].sum(axis=1), np.maximum(information[:, ~is_test].sum(axis=1), 1e-300)
        best = int(np.argmax(s**2 / f))
        size = s[best] / f[best]
        gain += float(size * score[best, is_test].sum() - 0.5 * size**2 * information[best, is_test].sum())
    return gain, int(fold.size)


def by_event(before: Extension, effect: Effect) -> tuple[Floats, Floats]:
    """Score and information of a small effect event by event, shape (event,)."""
    evidence = before.evidence
    data = evidence.data
    values = signature(effect.cause, before.baseline.terms, data.conditions, effect.law)
    is_member = effect.target.is_member
    shown = evidence.mean_of(values, is_member)
    mean = evidence.clean_mean(shown)
    score = np.einsum("def,def->e", mean, evidence.mean_dual)
    information = np.einsum("def,def->e", mean, evidence.mean_space.weigh(mean))
    # The deviations hold what each path shows, less what the mean of its letter shows.
    share = evidence.share_of_deviation(is_member)
    for k in np.flatnonzero(share).tolist():
        c = int(data.class_of[k])
        own = share[k] * evidence.clean_path(values[c], k)
        score += np.einsum("ef,ef->e", own, evidence.path_dual[k])
        information += evidence.weight[k] * np.einsum("ef,ef->e", own, evidence.path_spaces[c].weigh(own[None])[0])
    for d, count in enumerate(evidence.paths_of):
        space = evidence.letter_spaces[d]
        own = space.clean(shown[d : d + 1], evidence.letter_inverse[d], np.ones(len(score)))
        information -= count * np.einsum("def,def->e", own, space.weigh(own))
    return score, information
