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
from lbacal_core.discovery.targets import Nuisance, Target, find_nuisance, mean_over_paths
from lbacal_core.discovery.whitening import Residuals, split_residuals
from lbacal_core.grids import Floats

MAX_ROUNDS = 8
LARGEST_STEP = {"dipole_swap": 0.7}
DATE_BLOCKS, LST_BLOCKS, FOLDS = 8, 12, 4


@dataclass(frozen=True)
class Effect:
    """A cause under a law for a target, at a size with its standard deviation."""

    cause: Cause
    law: Law
    target: Target
    size: float
    sigma: float = np.inf


@dataclass(frozen=True)
class Extension:
    """The chain and the effects fitted together, and the residuals that are left."""

    effects: list[Effect]
    baseline: Baseline
    residuals: Residuals
    nuisance: Nuisance
    is_converged: bool


def power_ratio(data: StationData, terms: ChainTerms, effects: Sequence[Effect]) -> Floats | None:
    """Power with the effects over power without, shape (path, event, freq); None where there are none."""
    if not effects:
        return None
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


def fit_extension(
    data: StationData, effects: Sequence[Effect], before: Extension | None = None, modes: Floats | None = None
) -> Extension:
    """Fit the chain of every path and the sizes of all effects together.

    Parameters
    ----------
    before
        The model that is extended; without it the plain baseline is fitted.
    modes
        Relative changes of P_sky by which sky and antenna models differ, shape (mode, class, event, freq), or None.
    """
    baseline = fit_baseline(data, None if before is None else power_ratio(data, before.baseline.terms, effects))
    residuals = split_residuals(data, baseline.residual)
    if not effects or before is None:
        return Extension([], baseline, residuals, find_nuisance(data, residuals, baseline.terms, modes), True)
    current, nuisance, is_converged = list(effects), before.nuisance, False
    for _ in range(MAX_ROUNDS):
        # The weights stay those of the model before until the sizes stand still: they only weigh.
        weighed = replace(residuals, levels=before.residuals.levels)
        score, information = effect_products(data, weighed, nuisance, baseline.terms, current)
        step = np.linalg.solve(information, score)
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        limit = np.array([LARGEST_STEP.get(effect.cause.identifier, np.inf) for effect in current])
        step = np.clip(step, -limit, limit)
        is_converged = bool(np.all(np.abs(step) < 0.02 * sigma))
        current = [
            replace(effect, size=effect.size + float(d), sigma=float(s))
            for effect, d, s in zip(current, step, sigma, strict=True)
        ]
        baseline = fit_baseline(data, power_ratio(data, baseline.terms, current))
        residuals = split_residuals(data, baseline.residual)
        if is_converged:
            break
    nuisance = find_nuisance(data, residuals, baseline.terms, modes)
    return Extension(current, baseline, residuals, nuisance, is_converged)


def effect_products(
    data: StationData, residuals: Residuals, nuisance: Nuisance, terms: ChainTerms, effects: Sequence[Effect]
) -> tuple[Floats, Floats]:
    """Score and information matrix of the sizes of effects: derivatives of the log-likelihood."""
    signatures = [signature(e.cause, terms, data.conditions, e.law, e.size) for e in effects]
    by_event, information = event_products(data, residuals, nuisance, effects, signatures)
    return by_event.sum(axis=1), information.sum(axis=2)


def event_products(
    data: StationData,
    residuals: Residuals,
    nuisance: Nuisance,
    effects: Sequence[Effect],
    signatures: Sequence[Floats],
) -> tuple[Floats, Floats]:
    """Score, shape (effect, event), and information, shape (effect, effect, event), event by event."""
    events = residuals.mean.shape[1]
    of_mean = nuisance.clean_mean(residuals.whiten_mean(residuals.mean))
    means = np.stack(
        [
            mean_over_paths(data, residuals, values, effect.target.is_member)
            for effect, values in zip(effects, signatures, strict=True)
        ]
    )
    vectors = nuisance.clean_mean(residuals.whiten_mean(means))
    fold = event_of_mean(residuals)
    score = np.stack([_sum_by(fold, row * of_mean, events) for row in vectors])
    information = np.stack([[_sum_by(fold, a * b, events) for b in vectors] for a in vectors])
    letters = residuals.letters.tolist()
    fold = event_of_path(residuals)
    scale = residuals.levels.path_scale
    for members, index, concerned in _groups(data, effects):
        place = letters.index(data.dipole[members[0]])
        own = -means[:, place]
        for k in concerned:
            own[k] += signatures[k][index]
        vectors = nuisance.clean_path(residuals.whiten_path(own), index)
        total = residuals.whiten_path(np.tensordot(1.0 / scale[members] ** 2, residuals.deviation[members], axes=1))
        weight = float(np.sum(residuals.presence[members] / scale[members] ** 2))
        score += np.stack([_sum_by(fold, row * total, events) for row in vectors])
        information += weight * np.stack([[_sum_by(fold, a * b, events) for b in vectors] for a in vectors])
    return score, information


def event_of_mean(residuals: Residuals) -> NDArray[np.int64]:
    """Event of each entry of a whitened station-wide vector."""
    dipoles, events, channels = residuals.mean.shape
    of_rest = np.tile(np.repeat(np.arange(events), channels), dipoles)
    return np.concatenate([of_rest, np.tile(np.arange(events), dipoles)])


def event_of_path(residuals: Residuals) -> NDArray[np.int64]:
    """Event of each entry of a whitened vector of one path."""
    _, events, channels = residuals.mean.shape
    return np.concatenate([np.repeat(np.arange(events), channels), np.arange(events)])


def _sum_by(fold: NDArray[np.int64], values: Floats, events: int) -> Floats:
    return np.asarray(np.bincount(fold, weights=values, minlength=events), dtype=float)


def held_out_fold(data: StationData) -> NDArray[np.int64]:
    """Fold of each event: blocks of date and of 2 h of LST, because neighbouring events share conditions."""
    order = np.argsort(np.argsort(data.conditions.time_unix))
    date_block = order * DATE_BLOCKS // order.size
    lst_block = (data.conditions.lst_hours // (24 / LST_BLOCKS)).astype(int)
    return np.asarray((date_block + lst_block) % FOLDS)


def held_out_gain(
    data: StationData,
    before: Extension,
    effect: Effect,
    laws: Sequence[Law],
) -> tuple[float, int]:
    """Gain in log-likelihood on events not used, and their number.

    In each of the folds the law (a date, hours, a delay) is chosen again and the size fitted on the other folds.
    """
    fold = held_out_fold(data)
    rows = []
    for law in laws:
        candidate = replace(effect, law=law, size=0.0)
        values = signature(effect.cause, before.baseline.terms, data.conditions, law)
        score, information = event_products(data, before.residuals, before.nuisance, [candidate], [values])
        rows.append((score[0], information[0, 0]))
    score, information = (np.stack(part) for part in zip(*rows, strict=True))
    gain = 0.0
    for k in range(FOLDS):
        is_test = fold == k
        s, f = score[:, ~is_test].sum(axis=1), np.maximum(information[:, ~is_test].sum(axis=1), 1e-300)
        best = int(np.argmax(s**2 / f))
        size = s[best] / f[best]
        gain += float(size * score[best, is_test].sum() - 0.5 * size**2 * information[best, is_test].sum())
    return gain, int(fold.size)


def chi_squared(data: StationData, residuals: Residuals, nuisance: Nuisance, levels_of: Residuals) -> tuple[float, int]:
    """Chi^2 of the residuals, whitened with the levels of (other) residuals, and its degrees of freedom."""
    own = replace(residuals, levels=levels_of.levels)
    of_mean = nuisance.clean_mean(own.whiten_mean(own.mean))
    total, count = float(of_mean @ of_mean), of_mean.size - nuisance.mean.shape[1]
    for index in range(len(data.conditions.dipoles)):
        members = np.flatnonzero(data.class_of == index)
        shares = np.array([1.0 - 1.0 / np.sum(data.dipole == data.dipole[k]) for k in members])
        vectors = nuisance.clean_path(own.whiten_path(own.deviation[members]), index)
        squares = np.sum(vectors**2, axis=1) / own.levels.path_scale[members] ** 2
        total += float(squares.sum())
        size = vectors.shape[1] - nuisance.path[index].shape[1]
        count += int(np.sum(shares * size * residuals.presence[members]))
    return total, count
