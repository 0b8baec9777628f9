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

from lbacal_core.causes.cause import Cause, Template, spectral_signature
from lbacal_core.causes.conditions import Conditions
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.trials import p_of, significance, trials_factor
from lbacal_core.discovery.view import SMALLEST_SHARE, TimeProfiles, View, make_profiles
from lbacal_core.grids import Floats

MANY_SPECTRA = 8
"""Number of spectral templates above which each counts as an independent trial, as those of interference lines do."""
SMALLEST_INFORMATION = 1e-6
"""Information below which a unit of size moves the data by less than a thousandth of a standard deviation."""
BATCH_SIZE = 200_000
"""Values of the templates that are scored together: 1.6 MB stay in a fast memory."""
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
        Trials factor of this cause in this scan.
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


@dataclass(frozen=True)
class SpectralFamily:
    """Templates of a cause that share their spectral template and differ in their time profile alone."""

    cause: Cause
    templates: Sequence[Template]
    profiles: TimeProfiles

    def known_events(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Events on which the covariates of these templates are known, shape (event,)."""
        return self.cause.known_events(conditions, self.templates[0])


def group_templates(conditions: Conditions, cause: Cause, templates: Sequence[Template]) -> list[SpectralFamily]:
    """Group templates of a cause by spectral template and covariates; families with equal profiles share them."""
    groups: dict[tuple[object, ...], list[Template]] = {}
    for template in templates:
        alike = (*cause.spectral_key(template), cause.known_events(conditions, template).tobytes())
        groups.setdefault(alike, []).append(template)
    families, known = [], dict[str, TimeProfiles]()
    for members in groups.values():
        when = [{k: v for k, v in one.parameters.items() if k not in cause.spectral_parameters} for one in members]
        key = str(when)
        if key not in known:
            known[key] = make_profiles(np.stack([cause.time_profile(conditions, one)[:, 0] for one in members]))
        families.append(SpectralFamily(cause, members, known[key]))
    return families


def list_families(conditions: Conditions, causes: Sequence[Cause]) -> list[SpectralFamily]:
    """All templates of causes on these data."""
    return [family for cause in causes for family in group_templates(conditions, cause, cause.templates(conditions))]


def scan(model: LinearModel, causes: Sequence[Cause], targets: Sequence[Target], seed: int = 0) -> list[Score]:
    """The best score of each cause, most significant first."""
    families = list_families(model.station.conditions, causes)
    best: dict[str, Score] = {}
    trials: dict[str, float] = {}
    for known, alike in by_known_events(model, families):
        events = int(known.station.is_used.sum())
        for batch, z, size in score_families(known, alike, targets):
            at = s, t, k = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
            cause, template = batch[int(s)].cause, batch[int(s)].templates[int(k)]
            if z[at] and (cause.identifier not in best or abs(z[at]) > abs(best[cause.identifier].z)):
                found = Score(cause, template, targets[int(t)], float(z[at]), float(size[at]), events)
                best[cause.identifier] = found
        for name in {family.cause.identifier for family in alike} & best.keys():
            own = [family for family in alike if family.cause.identifier == name]
            trials[name] = trials.get(name, 0.0) + _count_trials(known, own, targets, seed)
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
    batches = _batches(families, model.station.power[0].size)
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


def _batches(families: Sequence[SpectralFamily], size: int) -> list[list[SpectralFamily]]:
    """Families of one cause with the same time profiles together, as many as fit into a fast memory."""
    most = max(1, BATCH_SIZE // size)
    batches: list[list[SpectralFamily]] = []
    for family in families:
        last = batches[-1] if batches else []
        if last and last[0].cause is family.cause and last[0].profiles is family.profiles and len(last) < most:
            last.append(family)
        else:
            batches.append([family])
    return batches


class _Scorer:
    """Scores of families with all their time profiles for all targets: `LinearModel.products` of many at once."""

    def __init__(self, model: LinearModel, targets: Sequence[Target]) -> None:
        self.model, self.targets = model, targets
        self.share_of_path = np.stack([model.share_of_deviation(target.is_member) for target in targets])
        self.share = np.stack([model.share_of_mean(target.is_member) for target in targets])
        self.counts = model.paths_in_mean[model.polarisation_of].astype(float)

    def score(self, batch: Sequence[SpectralFamily]) -> tuple[Floats, Floats]:
        """Score and information, shape (family, target, profile); 0 where the cause cannot affect the target."""
        model, cause, profiles = self.model, batch[0].cause, batch[0].profiles
        conditions = model.station.conditions
        spectra = np.stack([spectral_signature(cause, model.terms, conditions, one.templates[0]) for one in batch])
        score, information = np.zeros((2, len(batch), len(self.targets), len(profiles.values)))
        concerned = [t for t, target in enumerate(self.targets) if target.scope in cause.scopes]
        wide = [t for t in concerned if self.targets[t].scope == "station"]
        local = [t for t in concerned if t not in wide]
        differ = bool(wide) and model.modes is None and self._differ(spectra)
        shares = self.share[concerned]
        if not local and len(wide) == 1:  # the classes act together, and count as one
            shares, of_mean, mean_information = np.ones((1, 1)), *self._in_common(profiles, spectra, shares)
        else:
            of_mean, mean_information = self._in_common(profiles, spectra, np.eye(shares.shape[1]))
        for t, of_target in zip(concerned, shares, strict=True):
            at = np.flatnonzero(of_target)
            share = of_target[at]
            score[:, t] = np.einsum("c,scn->sn", share, of_mean[:, at])
            information[:, t] = np.einsum("c,g,scgn->sn", share, share, mean_information[:, at[:, None], at])
        if local or differ:
            of_path, path_information = self._in_paths(profiles, spectra)
            typical = np.stack([path_information[:, members].mean(axis=1) for members in model.members], axis=1)
            shown = concerned if differ else local
            score[:, shown] += self.share_of_path[shown] @ of_path
            information[:, shown] += self.share_of_path[shown] ** 2 @ path_information
            information[:, local] -= (self.counts * self.share[local] ** 2) @ typical
            # A path without events where the template acts does not change the mean either.
            is_shown = self.share_of_path[local] ** 2 @ path_information > 0
            score[:, local] *= is_shown
            information[:, local] *= is_shown
            if differ:
                information[:, wide] -= self._lost(profiles, spectra)[:, None]
        return score, information

    def _differ(self, spectra: Floats) -> bool:
        """Whether the classes of a polarisation show different spectral templates."""
        for d in range(len(self.model.paths_in_mean)):
            own = spectra[:, self.model.polarisation_of == d]
            if np.sum((own - own.mean(axis=1, keepdims=True)) ** 2) > ALIKE * np.sum(own**2):
                return True
        return False

    def _in_paths(self, profiles: TimeProfiles, spectra: Floats) -> tuple[Floats, Floats]:
        """Score and information in the deviation of every path, shape (family, path, profile)."""
        model = self.model
        score, information = np.empty((2, len(spectra), len(model.station.antenna), len(profiles.values)))
        for c, (view, members) in enumerate(zip(model.paths, model.members, strict=True)):
            seen = view.see(spectra[:, c][:, None, None])
            left, whole = (part[:, 0, 0] for part in view.inner(seen, profiles))
            is_left = left > SMALLEST_SHARE * whole
            information[:, members] = np.where(is_left, left, 0.0)
            score[:, members] = view.score_by_event(seen)[:, 0] @ profiles.values.T * is_left
        return score, information

    def _in_common(self, profiles: TimeProfiles, spectra: Floats, shares: Floats) -> tuple[Floats, Floats]:
        """Score and information in the means of classes taken together by shares, (part, class).

        Returns
        -------
        Shape (family, part, profile) and (family, part, part, profile).
        """
        model, view = self.model, self.model.common
        polarisation = model.polarisation_of
        alone = np.zeros((len(spectra), len(shares), *view.slope.shape))
        for c, share in enumerate(shares.T):
            alone[:, :, polarisation[c]] += share[:, None, None] * spectra[:, None, c]
        by_event = np.einsum("sgref,ref->sge", alone, view.weighted_residual[0])
        return by_event @ profiles.values.T, view.inner(view.see(alone), profiles)[0][:, :, :, 0]

    def _lost(self, profiles: TimeProfiles, spectra: Floats) -> Floats:
        """Information that the deviations lose because their mean is taken out, shape (family, profile)."""
        model = self.model
        mean = model.mean_of(spectra, np.ones(len(model.station.antenna), dtype=bool))
        lost = np.zeros((len(spectra), len(profiles.values)))
        for d, (view, count) in enumerate(zip(model.lost, model.paths_in_mean, strict=True)):
            lost += count * view.inner(view.see(mean[:, None, d : d + 1]), profiles)[0][:, 0, 0, 0]
        return lost


def _count_trials(
    model: LinearModel, families: Sequence[SpectralFamily], targets: Sequence[Target], seed: int
) -> float:
    """Trials factor of one cause: of its templates, for all its targets."""
    cause = families[0].cause
    copies = float(len(families)) if len(families) > MANY_SPECTRA else 1.0
    chosen = families[len(families) // 2 :][:1] if copies > 1 else families
    number = {scope: sum(target.scope == scope for target in targets) for scope in cause.scopes}
    total = 0.0
    if number.get("station"):
        everyone = Target("station", "station", np.ones(len(model.station.antenna), dtype=bool))
        total += trials_factor(correlate(model, chosen, everyone), seed)
    local = sum(count for scope, count in number.items() if scope != "station")
    if local:
        largest = int(np.argmax([len(members) for members in model.members]))
        typical = Target("path", "path", model.station.class_of == largest)
        total += local * trials_factor(correlate(model, chosen, typical), seed)
    return copies * max(total, 1.0)


def correlate(
    model: LinearModel,
    families: Sequence[SpectralFamily],
    target: Target,
    others: Sequence[SpectralFamily] | None = None,
) -> Floats:
    """Correlations of templates in the view that shows a target best.

    The means show the station; the deviation of a typical path shows anything narrower.

    Returns
    -------
    Shape (template, template): all of `families` with all of `others`, or with themselves.
    """
    every = [*families, *(others or [])]
    view, spectra = _best_view(model, every, target)
    seen = [view.see(one[None]) for one in spectra]
    profiles = [family.profiles for family in every]
    first = range(len(families))
    second = first if others is None else range(len(families), len(every))
    product = {
        (i, j): view.cross(seen[i], seen[j], profiles[i].values, profiles[j].values)[0]
        for i in first
        for j in second
        if others is not None or i <= j
    }
    if others is None:
        square = [np.diag(product[i, i]) for i in first]
        product |= {(j, i): product[i, j].T for i, j in product}
    else:
        square = [view.inner(one, own)[0][0, 0, 0] for one, own in zip(seen, profiles, strict=True)]
    size = [np.sqrt(np.maximum(one, SMALLEST_INFORMATION)) for one in square]
    return np.block([[product[i, j] / np.outer(size[i], size[j]) for j in second] for i in first])


def see_best(model: LinearModel, family: SpectralFamily, target: Target) -> Floats:
    """Information on a size of 1 with each time profile, in the view that shows a target best, shape (profile,)."""
    view, spectra = _best_view(model, [family], target)
    return np.asarray(view.inner(view.see(spectra), family.profiles)[0][0, 0, 0])


def _best_view(model: LinearModel, families: Sequence[SpectralFamily], target: Target) -> tuple[View, Floats]:
    """The view that shows a target best, and the spectral templates in it, shape (family, row, event, freq)."""
    conditions = model.station.conditions
    spectra = np.stack([spectral_signature(one.cause, model.terms, conditions, one.templates[0]) for one in families])
    if target.scope == "station":
        return model.common, model.mean_of(spectra, target.is_member)
    c = int(model.station.class_of[np.flatnonzero(target.is_member)[0]])
    return model.lost[int(model.polarisation_of[c])], spectra[:, c][:, None]
