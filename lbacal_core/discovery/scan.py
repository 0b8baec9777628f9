"""The score test: the significance of every cause, template and target without a refit.

The score of a template divided by the root of its information is a standard normal number where nothing is hidden. The
trials factor of each cause is simulated with the correlations of its templates in the data at hand. Every cause has the
same false-alarm rate, whatever the size of its family.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.families import FamilySpectra, SpectralFamily, batch_families, correlate, list_families
from lbacal_core.discovery.hypothesis import Target, p_of, significance, trials_factor
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.view import SMALLEST_INFORMATION, SMALLEST_SHARE
from lbacal_core.grids import Floats

MANY_SPECTRA = 8
"""Number of spectral templates above which each counts as an independent trial, as those of interference lines do."""
TIE_DIGITS = 6
"""Digits of a score, in standard deviations, to which two templates score alike."""
ALONE = np.eye(1), np.zeros(1, dtype=np.int64)
"""One spectrum in the one row of a view."""
WORTH_THREADS = 1_000_000
"""Values of a data set; below, threads wait for each other more than they compute."""
ALIKE = 1e-4
"""Difference between the templates of the classes of a polarisation (variance over mean square) below which the
scan treats them as equal: deviations of paths then add nothing to the score of a station-wide effect."""


@dataclass(frozen=True)
class Score:
    """The significance of one cause with one template for one target.

    Attributes
    ----------
    z
        Score in standard deviations, with its sign.
    size
        The size that fits best, to first order, in the cause's unit; `z` is size over its standard deviation.
    events
        Number of events on which the cause's covariate is known.
    trials
        Trials factor of this cause in this scan, at its score.
    causes
        Number of causes in the scan, each with the same false-alarm rate.
    """

    cause: Cause
    template: Template
    target: Target
    z: float
    size: float
    events: int
    trials: float = 1.0
    causes: int = 1

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters of its template."""
        return self.template.parameters

    @property
    def p_value(self) -> float:
        """Probability of a score as large, for any cause, template and target, where nothing is hidden."""
        return p_of(abs(self.z), self.trials * self.causes)

    @property
    def significance(self) -> float:
        """The score in standard deviations after the look-elsewhere correction, however small the probability."""
        return significance(abs(self.z), self.trials * self.causes)


def scan(model: LinearModel, causes: Sequence[Cause], targets: Sequence[Target], seed: int = 0) -> list[Score]:
    """The best score of each cause, most significant first."""
    families = list_families(model.station.conditions, causes)
    best: dict[str, Score] = {}
    trials: dict[str, float] = {}
    groups = by_known_events(model, families)
    for known, alike in groups:
        events = int(known.station.is_used.sum())
        for batch, z, size in score_families(known, alike, targets):
            # Hours and all others score alike with the other sign: the first of them counts, whatever the rounding.
            at = s, t, k = np.unravel_index(int(np.argmax(np.round(np.abs(z), TIE_DIGITS))), z.shape)
            cause, template = batch[int(s)].cause, batch[int(s)].templates[int(k)]
            if z[at] and (cause.identifier not in best or abs(z[at]) > abs(best[cause.identifier].z)):
                found = Score(cause, template, targets[int(t)], float(z[at]), float(size[at]), events)
                best[cause.identifier] = found
    for known, alike in groups:
        for name in {family.cause.identifier for family in alike} & best.keys():
            own = [family for family in alike if family.cause.identifier == name]
            trials[name] = trials.get(name, 0.0) + _count_trials(known, own, targets, seed, abs(best[name].z))
    scores = [replace(score, trials=trials[name], causes=len(best)) for name, score in best.items()]
    return sorted(scores, key=lambda score: (score.p_value, -abs(score.z)))


def by_known_events(
    model: LinearModel, families: Sequence[SpectralFamily]
) -> list[tuple[LinearModel, list[SpectralFamily]]]:
    """Families grouped by the events on which their covariates are known, with the model of these events alone."""
    groups: dict[bytes, tuple[LinearModel, list[SpectralFamily]]] = {}
    for family in families:
        is_known = family.known_events(model.station.conditions)
        key = is_known.tobytes()
        if key not in groups:
            groups[key] = model.on_events(is_known), []
        groups[key][1].append(family)
    return list(groups.values())


def score_families(
    model: LinearModel, families: Sequence[SpectralFamily], targets: Sequence[Target]
) -> list[tuple[Sequence[SpectralFamily], Floats, Floats]]:
    """Scores in standard deviations and sizes, shape (family, target, profile), of families batch by batch.

    Both are 0 where the free vectors describe the template, or where the cause cannot affect the target.
    """
    batches = batch_families(model.station.conditions, families, model.station.power[0].size)
    scorer = _Scorer(model, targets)
    if model.station.power.size > WORTH_THREADS:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            answers = list(pool.map(scorer.score, batches))
    else:
        answers = [scorer.score(batch) for batch in batches]
    found: list[tuple[Sequence[SpectralFamily], Floats, Floats]] = []
    for batch, (score, information) in zip(batches, answers, strict=True):
        is_seen = information > SMALLEST_INFORMATION
        known = np.where(is_seen, information, 1.0)
        found.append((batch, np.where(is_seen, score / np.sqrt(known), 0.0), np.where(is_seen, score / known, 0.0)))
    return found


class _Scorer:
    """Scores of families with all their time profiles for all targets: `LinearModel.products` of many at once."""

    def __init__(self, model: LinearModel, targets: Sequence[Target]) -> None:
        self.model, self.targets = model, targets
        self.share_of_path = np.stack([model.share_of_deviation(target.is_member) for target in targets])
        self.share = np.stack([model.share_of_mean(target.is_member) for target in targets])
        counts = model.paths_in_mean[model.polarisation_of]
        members = np.stack([target.is_member for target in targets])[:, None] & (
            model.station.class_of == np.arange(len(counts))[:, None]
        )
        lost = members * (counts * self.share**2 / np.maximum(members.sum(axis=2), 1))[..., None]
        self.lost_of_path = np.asarray(lost.sum(axis=1))

    def score(self, batch: Sequence[SpectralFamily]) -> tuple[Floats, Floats]:
        """Score and information, shape (family, target, profile); 0 where the cause cannot affect the target."""
        model, cause, profiles = self.model, batch[0].cause, batch[0].profiles
        spectra = FamilySpectra.of(model, batch)
        score, information = np.zeros((2, len(batch), len(self.targets), len(profiles)))
        concerned = [t for t, target in enumerate(self.targets) if target.scope in cause.scopes]
        wide = [t for t in concerned if self.targets[t].scope == "station"]
        local = [t for t in concerned if t not in wide]
        differ = self._differ(spectra) * (bool(wide) and model.modes is None)
        shares, classes = self.share[concerned], self.share.shape[1]
        together, part_of = np.unique(shares, axis=0, return_inverse=True)
        if len(together) < classes:  # targets of which the means show the same: their classes count as one
            shares = np.eye(len(together))[part_of]
        else:
            together = np.eye(classes)
        templates = spectra.in_view(model.common, spectra.values, together, model.polarisation_of)
        of_mean = model.common.score(templates, profiles)[:, :, 0]
        information_of_mean = model.common.inner(templates, profiles)[0][:, :, :, 0]
        for t, of_target in zip(concerned, shares, strict=True):
            at = np.flatnonzero(of_target)
            share = of_target[at]
            score[:, t] = np.einsum("c,scn->sn", share, of_mean[:, at])
            information[:, t] = np.einsum("c,g,scgn->sn", share, share, information_of_mean[:, at[:, None], at])
        if local or np.any(differ):
            of_path, path_information = self._in_paths(profiles, spectra)
            share = self.share_of_path * np.isin(np.arange(len(self.targets)), concerned)[:, None]
            shown = np.ones((len(batch), len(self.targets), 1))
            shown[:, wide] = differ[:, None, None]
            score += shown * (share @ of_path)
            information += shown * (share**2 @ path_information)
            # What the mean of the paths takes from the deviations is counted where the target itself has spectra.
            information[:, local] -= self.lost_of_path[local] @ path_information
            # A path without events where the template acts does not change the mean either.
            is_shown = self.share_of_path[local] ** 2 @ path_information > 0
            score[:, local] *= is_shown
            information[:, local] *= is_shown
            if np.any(differ):
                information[:, wide] -= (differ[:, None] * self._lost(profiles, spectra))[:, None]
        return score, information

    def _differ(self, spectra: FamilySpectra) -> NDArray[np.bool_]:
        """Whether the classes of a polarisation show different spectral templates, shape (family,)."""
        differ = []
        for d in range(len(self.model.paths_in_mean)):
            own = spectra.values[:, self.model.polarisation_of == d]
            apart, size = (np.sum(part**2, axis=(1, 2)) for part in (own - own.mean(axis=1, keepdims=True), own))
            factors = np.ones_like(size) if spectra.factors is None else spectra.factors
            differ.append(np.sum(factors**2 * apart, axis=1) > ALIKE * np.sum(factors**2 * size, axis=1))
        return np.asarray(np.any(differ, axis=0))

    def _in_paths(self, profiles: Floats, spectra: FamilySpectra) -> tuple[Floats, Floats]:
        """Score and information in the deviation of every path, shape (family, path, profile)."""
        found = []
        for c, view in enumerate(self.model.paths):
            templates = spectra.in_view(view, spectra.values[:, c : c + 1], *ALONE)
            left, whole = view.inner(templates, profiles)
            is_left = left[:, 0, 0] > SMALLEST_SHARE * whole[:, 0, 0]
            found.append(np.stack([view.score(templates, profiles)[:, 0], left[:, 0, 0]]) * is_left)
        both = np.empty((2, len(found[0][0]), len(self.model.station.antenna), len(profiles)))
        for members, of_class in zip(self.model.members, found, strict=True):
            both[:, :, members] = of_class
        return both[0], both[1]

    def _lost(self, profiles: Floats, spectra: FamilySpectra) -> Floats:
        """Information that the deviations lose because their mean is taken out, shape (family, profile)."""
        model = self.model
        mean = model.mean_of(spectra.values, np.ones(len(model.station.antenna), dtype=bool))
        lost = np.zeros((1, len(profiles)))
        for d, (view, count) in enumerate(zip(model.lost, model.paths_in_mean, strict=True)):
            templates = spectra.in_view(view, mean[:, d : d + 1], *ALONE)
            lost = lost + count * view.inner(templates, profiles)[0][:, 0, 0, 0]
        return lost


def _count_trials(
    model: LinearModel, families: Sequence[SpectralFamily], targets: Sequence[Target], seed: int, level: float
) -> float:
    """Trials factor of one cause at a score: of its templates, for all its targets."""
    cause = families[0].cause
    copies = float(len(families)) if len(families) > MANY_SPECTRA else 1.0
    chosen = families[len(families) // 2 :][:1] if copies > 1 else families
    number = {scope: sum(target.scope == scope for target in targets) for scope in cause.scopes}
    total = 0.0
    if number.get("station"):
        everyone = Target("station", "station", np.ones(len(model.station.antenna), dtype=bool))
        total += trials_factor(correlate(model, chosen, everyone), seed, level)
    local = sum(count for scope, count in number.items() if scope != "station")
    if local:
        largest = int(np.argmax([len(members) for members in model.members]))
        typical = Target("path", "path", model.station.class_of == largest)
        total += local * trials_factor(correlate(model, chosen, typical), seed, level)
    return copies * max(total, 1.0)
