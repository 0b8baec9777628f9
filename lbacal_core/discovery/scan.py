"""The score test: the significance of every cause, law and target without a refit.

The score of a signature divided by the root of its information is a standard normal number where nothing is hidden. A
signature is what a cause does, its *shape*, times when it does it, its *course*; shapes are few, so dates and hours are
scanned at the price of sums over events. Look-elsewhere: the distribution of each cause's largest score is simulated
with the correlations that its signatures have in the data at hand, and carried on to small probabilities as that of the
equivalent number of independent scores; causes count alike, whatever the size of their families.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.terms import Cause, Conditions, Law, shape_signature, signature
from lbacal_core.discovery.chance import equivalent_trials, p_of, significance
from lbacal_core.discovery.evidence import Evidence, Space
from lbacal_core.discovery.targets import Target
from lbacal_core.grids import Floats

MANY_COURSES, MANY_SHAPES = 8, 8
SMALLEST_INFORMATION = 1e-6
"""Below this a unit of size moves the data by a thousandth of a standard deviation."""
BATCH_SIZE = 200_000
WORTH_THREADS = 1_000_000
"""Values of a data set; below, threads wait for each other more than they compute."""
SMALLEST_SHARE = 1e-6
"""Below this share of its information a signature counts as absorbed by the fit."""
INDISTINGUISHABLE = 9.0
"""SNR^2 (1 - r^2) below this: the other signature fits as well (3 standard deviations)."""
SPREAD = 1e-4
"""Classes of paths whose signatures differ by less (variance over square) say nothing against each other."""


@dataclass(frozen=True)
class Score:
    """The significance of one cause under one law for one target.

    Attributes
    ----------
    z
        Score in standard deviations, with its sign.
    size
        The size that fits best, to first order, in the cause's unit; `z` is size over its standard deviation.
    trials
        Equivalent number of independent scores of this cause in this scan.
    causes
        Number of causes that were looked for, each with the same right to a false alarm.
    """

    cause: Cause
    law: Law
    target: Target
    z: float
    size: float
    trials: float
    causes: int

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Of its law."""
        return self.law.parameters

    @property
    def p_value(self) -> float:
        """Probability of such a score from any cause's whole family and any target where nothing is hidden."""
        return p_of(abs(self.z), self.trials * self.causes)

    @property
    def significance(self) -> float:
        """The score as a normal number after the look-elsewhere correction, however small the probability."""
        return significance(abs(self.z), self.trials * self.causes)


@dataclass(frozen=True)
class Courses:
    """When laws act: their courses, and the sets of events that all of them treat alike.

    Attributes
    ----------
    values
        Shape (law, event).
    order, begins
        Events sorted by set, and where each set begins.
    by_set
        Shape (law, set).
    """

    values: Floats
    order: NDArray[np.int64]
    begins: NDArray[np.int64]
    by_set: Floats

    def sum(self, values: Floats) -> Floats:
        """Sums over the events of values times each course, (..., event, n) -> (..., law, n)."""
        if len(self.begins) == len(self.order):
            return self.values @ values
        return np.asarray(self.by_set @ np.add.reduceat(values[..., self.order, :], self.begins, axis=-2))


def make_courses(values: Floats) -> Courses:
    """Courses with their sets of events, where they are many, such as hours and dates."""
    if len(values) <= MANY_COURSES:
        events = np.arange(values.shape[1])
        return Courses(values, events, events, values)
    by_set, set_of = np.unique(values, axis=1, return_inverse=True)
    order = np.argsort(set_of.ravel(), kind="stable")
    return Courses(values, order, np.searchsorted(set_of.ravel()[order], np.arange(by_set.shape[1])), by_set)


@dataclass(frozen=True)
class Shape:
    """What a cause does under laws that differ only in when."""

    cause: Cause
    laws: Sequence[Law]
    courses: Courses


def group_laws(conditions: Conditions, cause: Cause, laws: Sequence[Law]) -> list[Shape]:
    """Laws of a cause by what they do; those that act at the same times share their courses."""
    groups: dict[tuple[object, ...], list[Law]] = {}
    for law in laws:
        groups.setdefault(cause.shape_of(law), []).append(law)
    shapes, courses = [], dict[str, Courses]()
    for alike in groups.values():
        when = [{k: v for k, v in law.parameters.items() if k not in cause.shaped_by} for law in alike]
        key = str(when)
        if key not in courses:
            courses[key] = make_courses(np.stack([cause.course(conditions, law)[:, 0] for law in alike]))
        shapes.append(Shape(cause, alike, courses[key]))
    return shapes


def list_shapes(evidence: Evidence, causes: Sequence[Cause]) -> list[Shape]:
    """The shapes of all laws of causes on these data."""
    conditions = evidence.data.conditions
    return [shape for cause in causes for shape in group_laws(conditions, cause, cause.laws(conditions))]


def scan(evidence: Evidence, causes: Sequence[Cause], targets: Sequence[Target], seed: int = 0) -> list[Score]:
    """The best score of each cause, most significant first."""
    shapes = list_shapes(evidence, causes)
    best: dict[str, Score] = {}
    for batch, z, size in score_shapes(evidence, shapes, targets):
        at = s, t, k = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        cause, law = batch[int(s)].cause, batch[int(s)].laws[int(k)]
        if z[at] and (cause.identifier not in best or abs(z[at]) > abs(best[cause.identifier].z)):
            best[cause.identifier] = Score(cause, law, targets[int(t)], float(z[at]), float(size[at]), 1.0, 1)
    families = {name: [shape for shape in shapes if shape.cause.identifier == name] for name in best}
    found = [
        replace(score, trials=_count_trials(evidence, families[name], targets, seed), causes=len(best))
        for name, score in best.items()
    ]
    return sorted(found, key=lambda score: (score.p_value, -abs(score.z)))


def score_shapes(
    evidence: Evidence, shapes: Sequence[Shape], targets: Sequence[Target]
) -> list[tuple[Sequence[Shape], Floats, Floats]]:
    """Scores in standard deviations and sizes, shape (shape, target, law), of shapes batch by batch.

    Both are 0 where the fit absorbs the signature, or where the cause cannot concern the target.
    """
    batches = _batches(shapes, evidence.data.power[0].size)
    scorer = _Scorer(evidence, targets)
    if evidence.data.power.size > WORTH_THREADS:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            answers = list(pool.map(scorer.score, batches))
    else:
        answers = [scorer.score(batch) for batch in batches]
    found: list[tuple[Sequence[Shape], Floats, Floats]] = []
    for batch, (score, information) in zip(batches, answers, strict=True):
        is_seen = information > SMALLEST_INFORMATION
        known = np.where(is_seen, information, 1.0)
        found.append((batch, np.where(is_seen, score / np.sqrt(known), 0.0), np.where(is_seen, score / known, 0.0)))
    return found


def _batches(shapes: Sequence[Shape], size: int) -> list[list[Shape]]:
    """Shapes of one cause with the same courses together, as many as fit into a fast memory."""
    most = max(1, BATCH_SIZE // size)
    batches: list[list[Shape]] = []
    for shape in shapes:
        last = batches[-1] if batches else []
        if last and last[0].cause is shape.cause and last[0].courses is shape.courses and len(last) < most:
            last.append(shape)
        else:
            batches.append([shape])
    return batches


class _Scorer:
    """Scores of shapes under all their laws for all targets."""

    def __init__(self, evidence: Evidence, targets: Sequence[Target]) -> None:
        self.evidence, self.targets = evidence, targets
        self.share_of_path = np.stack([evidence.share_of_deviation(target.is_member) for target in targets])
        self.share = np.stack([evidence.share_of_mean(target.is_member) for target in targets])
        self.counts = evidence.paths_of[evidence.letter_of].astype(float)
        # Computed here once, before the threads ask for them.
        _ = (evidence.path_dual, evidence.mean_dual, evidence.letter_inverse, evidence.letter_spaces)

    def score(self, batch: Sequence[Shape]) -> tuple[Floats, Floats]:
        """Score and information, shape (shape, target, law); no information where a cause cannot concern a target."""
        evidence, cause, courses = self.evidence, batch[0].cause, batch[0].courses
        conditions = evidence.data.conditions
        signatures = np.stack([shape_signature(cause, evidence.terms, conditions, one.laws[0]) for one in batch])
        score, information = np.zeros((2, len(batch), len(self.targets), len(courses.values)))
        concerned = [t for t, target in enumerate(self.targets) if target.scope in cause.scopes]
        wide = [t for t in concerned if self.targets[t].scope == "station"]
        local = [t for t in concerned if t not in wide]
        is_spread = bool(wide) and self._differs(signatures)
        of_mean, mean_information = self._of_classes(courses, signatures)
        for t in concerned:
            at = np.flatnonzero(self.share[t])
            share = self.share[t, at]
            score[:, t] = np.einsum("c,scn->sn", share, of_mean[:, at])
            of_both = mean_information[:, at[:, None], at]
            information[:, t] = np.einsum("c,g,scgn->sn", share, share, of_both)
        if local or is_spread:
            of_path, path_information = self._of_paths(courses, signatures)
            typical = np.stack([path_information[:, members].mean(axis=1) for members in evidence.members], axis=1)
            shown = concerned if is_spread else local
            score[:, shown] += self.share_of_path[shown] @ of_path
            information[:, shown] += self.share_of_path[shown] ** 2 @ path_information
            information[:, local] -= (self.counts * self.share[local] ** 2) @ typical
            # A path that was silent all the time that a law acts shows nothing of it in the mean either.
            is_shown = self.share_of_path[local] ** 2 @ path_information > 0
            score[:, local] *= is_shown
            information[:, local] *= is_shown
            if is_spread:
                information[:, wide] -= self._of_letters(courses, signatures)[:, None]
        return score, information

    def _differs(self, signatures: Floats) -> bool:
        """Whether the classes of a letter show different signatures."""
        for d in range(len(self.evidence.paths_of)):
            own = signatures[:, self.evidence.letter_of == d]
            if np.sum((own - own.mean(axis=1, keepdims=True)) ** 2) > SPREAD * np.sum(own**2):
                return True
        return False

    def _of_paths(self, courses: Courses, signatures: Floats) -> tuple[Floats, Floats]:
        """Score and information of the deviations of every path, shape (shape, path, law)."""
        evidence = self.evidence
        score, information = np.empty((2, len(signatures), len(evidence.data.antenna), len(courses.values)))
        for c, (space, members) in enumerate(zip(evidence.path_spaces, evidence.members, strict=True)):
            own = signatures[:, c]
            weighed = space.weigh(own[:, None])
            weight = evidence.weight[members]
            by_event = np.einsum("kef,sef->ske", evidence.path_dual[members], own, optimize=True)
            score[:, members] = by_event @ courses.values.T
            square = np.einsum("sef,sef->se", own, weighed[:, 0])
            absorbed = space.absorbed_of(weighed)
            lost = courses.sum(weight[:, :, None] * absorbed[:, None])
            whole = (weight * square[:, None]) @ courses.values.T**2
            left = whole - np.sum((lost @ evidence.path_inverse[members]) * lost, axis=-1)
            # Of a signature that the fit absorbs, such as a step after a path fell silent, rounding errors are left.
            is_left = left > SMALLEST_SHARE * whole
            information[:, members] = np.where(is_left, left, 0.0)
            score[:, members] *= is_left
        return score, information

    def _of_classes(self, courses: Courses, signatures: Floats) -> tuple[Floats, Floats]:
        """Score (shape, class, law) and information (shape, class, class, law) in the station's mean."""
        evidence, space = self.evidence, self.evidence.mean_space
        letters = evidence.letter_of
        alone = np.zeros((len(signatures), len(letters), *space.front.shape))
        alone[:, np.arange(len(letters)), letters] = signatures
        by_event = np.einsum("scef,cef->sce", signatures, evidence.mean_dual[letters])
        return by_event @ courses.values.T, _class_information(space, evidence.mean_inverse, alone, courses)

    def _of_letters(self, courses: Courses, signatures: Floats) -> Floats:
        """Information that the deviations lose because their mean is taken out, shape (shape, law)."""
        evidence = self.evidence
        mean = evidence.mean_of(signatures, np.ones(len(evidence.data.antenna), dtype=bool))
        lost = np.zeros((len(signatures), len(courses.values)))
        for d, count in enumerate(evidence.paths_of):
            space, inverse = evidence.letter_spaces[d], evidence.letter_inverse[d]
            lost += count * _class_information(space, inverse, mean[:, None, d : d + 1], courses)[:, 0, 0]
        return lost


def _class_information(space: Space, inverse: Floats, values: Floats, courses: Courses) -> Floats:
    """Information of vectors of shape (..., k, row, event, freq) under each course, shape (..., k, k, law)."""
    weighed = space.weigh(values)
    absorbed = courses.sum(space.absorbed_of(weighed))
    both = np.einsum("...cref,...gref->...cge", values, weighed)
    lost = np.einsum("...cni,...gni->...cgn", absorbed @ inverse, absorbed)
    return np.asarray(both @ courses.values.T**2 - lost)


def _count_trials(evidence: Evidence, shapes: Sequence[Shape], targets: Sequence[Target], seed: int) -> float:
    """Equivalent number of independent scores of one cause: of its laws, for all its targets."""
    cause = shapes[0].cause
    copies = float(len(shapes)) if len(shapes) > MANY_SHAPES else 1.0
    chosen = shapes[len(shapes) // 2 :][:1] if copies > 1 else shapes
    number = {scope: sum(target.scope == scope for target in targets) for scope in cause.scopes}
    signatures = np.stack(
        [shape_signature(cause, evidence.terms, evidence.data.conditions, shape.laws[0]) for shape in chosen]
    )
    total = 0.0
    if number.get("station"):
        everyone = np.ones(len(evidence.data.antenna), dtype=bool)
        vectors = evidence.mean_of(signatures, everyone)
        correlation = correlate(evidence.mean_space, evidence.mean_inverse, vectors, chosen)
        total += equivalent_trials(correlation, seed)
    local = sum(count for scope, count in number.items() if scope != "station")
    if local:
        c = int(np.argmax([len(members) for members in evidence.members]))
        d = int(evidence.letter_of[c])
        correlation = correlate(
            evidence.letter_spaces[d], evidence.letter_inverse[d], signatures[:, c][:, None], chosen
        )
        total += local * equivalent_trials(correlation, seed)
    return copies * max(total, 1.0)


def correlate(space: Space, inverse: Floats, values: Floats, shapes: Sequence[Shape]) -> Floats:
    """Correlations of all laws of shapes whose vectors have shape (shape, row, event, freq)."""
    weighed = space.weigh(values)
    absorbed = space.absorbed_of(weighed)
    both = np.einsum("iref,jref->ije", values, weighed, optimize=True)
    lost = np.concatenate([shape.courses.values @ own for shape, own in zip(shapes, absorbed, strict=True)])
    blocks = [
        [(left.courses.values * both[i, j]) @ right.courses.values.T for j, right in enumerate(shapes)]
        for i, left in enumerate(shapes)
    ]
    product = np.block(blocks) - lost @ inverse @ lost.T
    size = np.sqrt(np.maximum(np.diag(product), SMALLEST_INFORMATION))
    return np.asarray(product / np.outer(size, size))


def correlate_with(
    evidence: Evidence, cause: Cause, law: Law, target: Target, others: Sequence[Cause]
) -> list[tuple[Cause, float]]:
    """The largest correlation that each shape of other causes has, under any law, with a signature of a target."""
    conditions = evidence.data.conditions
    shapes = list_shapes(evidence, others)
    values = [signature(cause, evidence.terms, conditions, law)]
    values += [shape_signature(shape.cause, evidence.terms, conditions, shape.laws[0]) for shape in shapes]
    if target.scope == "station":
        space, inverse = evidence.mean_space, evidence.mean_inverse
        vectors = evidence.mean_of(np.stack(values), target.is_member)
    else:
        c = int(evidence.data.class_of[np.flatnonzero(target.is_member)[0]])
        d = int(evidence.letter_of[c])
        space, inverse = evidence.letter_spaces[d], evidence.letter_inverse[d]
        vectors = np.stack(values)[:, c][:, None]
    own = space.weigh(vectors[0])
    absorbed = space.absorbed_of(own).sum(axis=0)
    size = float(np.sum(vectors[0] * own) - absorbed @ inverse @ absorbed) ** 0.5
    found = []
    for shape, vector in zip(shapes, vectors[1:], strict=True):
        weighed = space.weigh(vector)
        lost = shape.courses.values @ space.absorbed_of(weighed)
        square = shape.courses.values**2 @ np.einsum("ref,ref->e", vector, weighed)
        square -= np.einsum("ni,ij,nj->n", lost, inverse, lost, optimize=True)
        product = shape.courses.values @ np.einsum("ref,ref->e", vector, own) - lost @ inverse @ absorbed
        r = np.abs(product) / (size * np.sqrt(np.maximum(square, SMALLEST_INFORMATION)))
        found.append((shape.cause, float(r.max())))
    return found
