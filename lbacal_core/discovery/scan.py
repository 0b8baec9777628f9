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

from lbacal_core.causes.cause import Cause, Conditions, Template, spectral_signatures
from lbacal_core.discovery.hypothesis import Hypothesis, Target, p_of, significance, trials_factor
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.view import (
    SMALLEST_EIGENVALUE,
    SMALLEST_INFORMATION,
    SMALLEST_SHARE,
    ChannelTemplates,
    Seen,
    View,
)
from lbacal_core.grids import Floats

# Families of templates of a cause, and their spectra as a scan takes them together.
#
# A template is a spectral template times a time profile. Templates that share the first form a family; families of one
# cause with the same profiles are scored together. Spectra that are one spectrum times factors along frequency, as
# those of interference lines are, cost little more than that one.

BATCH_SIZE = 200_000
"""Values of the templates that are scored together: 1.6 MB stay in a fast memory."""
MOST_FACTORS = 256
"""Factors along frequency that are scored together."""


@dataclass(frozen=True)
class SpectralFamily:
    """Templates of a cause that share their spectral template and differ in their time profile alone.

    Attributes
    ----------
    profiles
        When each of them acts, shape (template, event).
    """

    cause: Cause
    templates: Sequence[Template]
    profiles: Floats

    def known_events(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Events on which the covariates of these templates are known, shape (event,)."""
        return self.cause.known_events(conditions, self.templates[0])


def group_templates(conditions: Conditions, cause: Cause, templates: Sequence[Template]) -> list[SpectralFamily]:
    """Group templates of a cause by spectral template and covariates; families with equal profiles share them."""
    groups: dict[tuple[object, ...], list[Template]] = {}
    for template in templates:
        alike = (*cause.spectral_key(template), cause.known_events(conditions, template).tobytes())
        groups.setdefault(alike, []).append(template)
    families, known = [], dict[str, Floats]()
    for members in groups.values():
        when = [{k: v for k, v in one.parameters.items() if k not in cause.spectral_parameters} for one in members]
        key = str(when)
        if key not in known:
            known[key] = np.stack([cause.time_profile(conditions, one)[:, 0] for one in members])
        families.append(SpectralFamily(cause, members, known[key]))
    return families


def list_families(conditions: Conditions, causes: Sequence[Cause]) -> list[SpectralFamily]:
    """All templates of causes on these data."""
    return [family for cause in causes for family in group_templates(conditions, cause, cause.templates(conditions))]


def batch_families(conditions: Conditions, families: Sequence[SpectralFamily], size: int) -> list[list[SpectralFamily]]:
    """Families of one cause with the same time profiles together, as many as fit into a fast memory.

    Factors along frequency need little of it.
    """
    batches: list[list[SpectralFamily]] = []
    for family in families:
        last = batches[-1] if batches else []
        has_factor = family.cause.factor(conditions, family.templates[0]) is not None
        most = MOST_FACTORS if has_factor else max(1, BATCH_SIZE // size)
        if last and last[0].cause is family.cause and last[0].profiles is family.profiles and len(last) < most:
            last.append(family)
        else:
            batches.append([family])
    return batches


@dataclass(frozen=True)
class FamilySpectra:
    """The spectral templates of families of one cause: each by itself, or as one spectrum times factors.

    Attributes
    ----------
    values
        Shape (family, class, event, freq), or 1 for family where there are factors.
    factors
        Shape (family, freq), or None.
    """

    values: Floats
    factors: Floats | None

    @classmethod
    def of(cls, model: LinearModel, batch: Sequence[SpectralFamily]) -> FamilySpectra:
        """The spectral templates of a batch."""
        cause, conditions = batch[0].cause, model.station.conditions
        first = [one.templates[0] for one in batch]
        factors = [factor for one in first if (factor := cause.factor(conditions, one)) is not None]
        shown = [cause.flat(first[0])] if factors else first
        values = spectral_signatures(cause, model.terms, conditions, shown)
        return cls(values, np.stack(factors) if factors else None)

    @property
    def whole(self) -> Floats:
        """Every spectral template, shape (family, class, event, freq)."""
        return self.values if self.factors is None else np.asarray(self.values * self.factors[:, None, None])

    def in_view(self, view: View, values: Floats, shares: Floats, row_of: NDArray[np.int64]) -> Seen | ChannelTemplates:
        """The templates as a view sees them, shape (family, part).

        Parameters
        ----------
        values
            Spectra in rows of the view, shape (family, k, event, freq).
        shares
            Parts in which they act together, shape (part, k).
        row_of
            Row of each, shape (k,).
        """
        if self.factors is not None:
            return ChannelTemplates(values[0], row_of, shares, self.factors)
        alone = np.zeros((len(values), len(shares), *view.slope.shape))
        for k, share in enumerate(shares.T):
            alone[:, :, row_of[k]] += share[:, None, None] * values[:, None, k]
        return view.see(alone)


# How alike templates are, and how much of each the data hold, in the view that shows a target best.


def correlate(model: LinearModel, families: Sequence[SpectralFamily], target: Target) -> Floats:
    """Correlations of all templates of families in the view that shows a target best, shape (template, template).

    The means show the station; the deviation of a typical path shows anything narrower. Rows of templates that are free
    are 0: what is left of them is rounding, which is no trial.
    """
    view, spectra = _best_view(model, target, [FamilySpectra.of(model, [one]) for one in families])
    product = view.products([view.see(one.whole) for one in spectra], [family.profiles for family in families])[0]
    information = np.diag(product)
    # profiling out leaves rounding of what a template had, which grows with the data and with the kernel of the algebra
    smallest = max(SMALLEST_INFORMATION, SMALLEST_EIGENVALUE * information.max(initial=0.0))
    size = np.sqrt(np.where(information > smallest, information, np.inf))
    return np.asarray(product / np.outer(size, size))


def overlap(
    model: LinearModel, cause: Cause, template: Template, target: Target, others: Sequence[SpectralFamily]
) -> list[Floats]:
    """Correlations of one template with all of each of some families, as in `correlate`, shape (template,) each.

    They are scores: the one template stands in the place of the residuals. Those of templates that are free are 0.
    """
    conditions = model.station.conditions
    batches = batch_families(conditions, others, model.station.power[0].size)
    (own,) = group_templates(conditions, cause, [template])
    view, (alone, *spectra) = _best_view(model, target, [FamilySpectra.of(model, batch) for batch in ([own], *batches)])
    values = alone.whole[0] * own.profiles[0][:, None]
    dual, everyone = view.weigh_clean(values)[None], np.ones((1, conditions.time_unix.size))
    length = np.sqrt(view.inner(view.see(values[None]), everyone)[0].item())
    found = []
    for batch, one in zip(batches, spectra, strict=True):
        rows = np.arange(one.values.shape[1])
        templates = one.in_view(view, one.values, np.ones((1, rows.size)), rows)
        score = view.score(templates, batch[0].profiles, dual)[:, 0, 0]
        information, whole = (one[:, 0, 0, 0] for one in view.inner(templates, batch[0].profiles))
        is_left = information > np.maximum(SMALLEST_INFORMATION, SMALLEST_SHARE * whole)
        found += list(score / (length * np.sqrt(np.where(is_left, information, np.inf))))
    return found


def see_best(models: Sequence[LinearModel], family: SpectralFamily, target: Target) -> list[Floats]:
    """Information on a size of 1 with each time profile, in the view of each model that shows a target best.

    The models have the same chain.

    Returns
    -------
    Shape (profile,) for each model.
    """
    spectra = [FamilySpectra.of(models[0], [family])]
    found = []
    for model in models:
        view, (one,) = _best_view(model, target, spectra)
        found.append(view.inner(view.see(one.whole), family.profiles)[0][0, 0, 0])
    return found


def _best_view(
    model: LinearModel, target: Target, spectra: Sequence[FamilySpectra]
) -> tuple[View, list[FamilySpectra]]:
    """The view that shows a target best, and the spectral templates in it, their classes the rows of the view."""
    if target.has_all_antennas:
        return model.common, [replace(one, values=model.mean_of(one.values, target.is_member)) for one in spectra]
    c = int(model.station.class_of[np.flatnonzero(target.is_member)[0]])
    view = model.lost[int(model.polarisation_of[c])]
    return view, [replace(one, values=one.values[:, c : c + 1]) for one in spectra]


# What nuisances take: causes that differences between sky models hide, and what the noise's vectors take of each.
#
# With the amounts of the differences free without limit, no information on such a cause is left. What their prior
# leaves tells how much models differ, and nothing about the instrument. The noise that events share along frequency
# takes a part of the information on every cause, which the report gives.

NEARLY_FREE = 1e-4
"""Inverse variance of differences a hundred times as large as those of real models."""


@dataclass(frozen=True)
class HiddenCause:
    """A cause of the whole station that the differences between models describe.

    Attributes
    ----------
    share
        Share of its information that is left under the prior.
    sigma, plain_sigma
        Standard deviation of its size with the differences profiled out, and with the sky taken as exact.
    """

    cause: Cause
    share: float
    sigma: float
    plain_sigma: float

    @property
    def why(self) -> str:
        """The reason in a report."""
        return (
            "the differences between sky and antenna models describe its signature: "
            f"{self.share:.1%} of its information is left, one standard deviation is {self.sigma:.2g} "
            f"({self.cause.unit}) instead of {self.plain_sigma:.2g}; a sky power at its word shows it"
        )


def list_hidden(
    model: LinearModel, causes: Sequence[Cause], target: Target, smallest_share: float
) -> list[HiddenCause]:
    """Causes of the whole station of which free differences leave less than `smallest_share` of the information.

    The shares are computed for the data at hand; the list is empty where the sky power is taken as exact.
    """
    if model.modes is None:
        return []
    # A cause that smooth waves along LST describe shows beside them where it is larger than these.
    known = replace(model, modes=replace(model.modes, waves=None))
    plain, free = replace(model, modes=None), replace(known, modes=replace(model.modes, waves=None, prior=NEARLY_FREE))
    hidden = []
    for cause in causes:
        if cause.scopes != ("station",) or "lst" not in cause.axes:
            continue
        families = list_families(model.station.conditions, [cause])
        seen = [see_best((plain, free, known), family, target) for family in families]
        whole, bare, left = (np.array([one[m].max() for one in seen]) for m in range(3))
        if not whole.size or whole.min() <= 0:
            continue
        # Information is a difference here; nothing left of it may come out below 0.
        bare, left = (np.maximum(one, np.finfo(float).eps * whole) for one in (bare, left))
        # A wider prior leaves less; where it leaves more, that is rounding.
        if np.all(np.minimum(bare, left) < smallest_share * whole):
            best = int(np.argmax(left / whole))
            sigma, plain_sigma = float(left[best] ** -0.5), float(whole[best] ** -0.5)
            hidden.append(HiddenCause(cause, float(left[best] / whole[best]), sigma, plain_sigma))
    return hidden


def shares_taken(model: LinearModel, causes: Sequence[Cause], target: Target) -> dict[str, float]:
    """Share of the information on each cause of the station that the vectors of the noise take."""
    plain = model.with_levels(model.residuals.levels.of_channels)
    taken = {}
    for cause in causes:
        families = list_families(model.station.conditions, [cause]) if "station" in cause.scopes else []
        if families:
            typical = families[len(families) // 2]
            left, whole = see_best((model, plain), typical, target)
            best = int(np.argmax(whole))
            if whole[best] > 0:
                taken[cause.identifier] = float(1.0 - left[best] / whole[best])
    return taken


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
    """The best score of each cause, most significant first; a cause without a template for these data has none."""
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


def score_in_means(
    model: LinearModel, families: Sequence[SpectralFamily], target: Target
) -> list[tuple[Sequence[SpectralFamily], Floats, Floats]]:
    """As `score_families` for all antennas, by the means of their paths alone, which hold almost all that they show."""
    found: list[tuple[Sequence[SpectralFamily], Floats, Floats]] = []
    for batch in batch_families(model.station.conditions, families, model.station.power[0].size):
        spectra = FamilySpectra.of(model, batch)
        shown = model.mean_of(spectra.values, target.is_member)
        rows = np.arange(shown.shape[1])
        templates = spectra.in_view(model.common, shown, np.ones((1, rows.size)), rows)
        found.append((batch, *_score_alone(model.common, templates, batch[0].profiles)))
    return found


def _score_alone(view: View, templates: Seen | ChannelTemplates, profiles: Floats) -> tuple[Floats, Floats]:
    """Scores in standard deviations and sizes of single templates in a view of one member, (family, 1, profile)."""
    left, every = view.inner(templates, profiles)
    is_left = left[:, 0, 0] > SMALLEST_SHARE * every[:, 0, 0]
    known = np.where(is_left, left[:, 0, 0], np.inf)
    score = view.score(templates, profiles)[:, 0]
    return score / np.sqrt(known), score / known


def score_in_path(
    model: LinearModel, families: Sequence[SpectralFamily], path: int
) -> list[tuple[Sequence[SpectralFamily], Floats, Floats]]:
    """As `score_families` for one path, by its deviation from the others alone: many times as quick."""
    c = int(model.station.class_of[path])
    view = _of_members(model.paths[c], model.members[c] == path)
    found: list[tuple[Sequence[SpectralFamily], Floats, Floats]] = []
    for batch in batch_families(model.station.conditions, families, model.station.power[0].size):
        spectra = FamilySpectra.of(model, batch)
        templates = spectra.in_view(view, spectra.values[:, c : c + 1], *ALONE)
        found.append((batch, *_score_alone(view, templates, batch[0].profiles)))
    return found


def _of_members(view: View, is_kept: NDArray[np.bool_]) -> View:
    """A view of some of its members alone."""
    return replace(view, weight=view.weight[is_kept], residual=view.residual[is_kept])


class _Scorer:
    """Scores of families with all their time profiles for all targets: `LinearModel.products` of many at once."""

    def __init__(self, model: LinearModel, targets: Sequence[Target]) -> None:
        self.model, self.targets = model, targets
        self.share_of_path = np.stack([model.share_of_deviation(target.is_member) for target in targets])
        self.share = np.stack([model.share_of_mean(target.is_member) for target in targets])
        self.of_polarisation = np.eye(len(model.paths_in_mean))[model.polarisation_of]
        counts = model.paths_in_mean[model.polarisation_of]
        members = np.stack([target.is_member for target in targets])[:, None] & (
            model.station.class_of == np.arange(len(counts))[:, None]
        )
        lost = members * (counts * self.share**2 / np.maximum(members.sum(axis=2), 1))[..., None]
        self.lost_of_path = np.asarray(lost.sum(axis=1))
        # Paths that no target shows cost as much as those that one does.
        is_shown = np.any((self.share_of_path != 0) | (self.lost_of_path != 0), axis=0)
        self.shown = [members[is_shown[members]] for members in model.members]
        self.views = [
            view if is_shown[members].all() else _of_members(view, is_shown[members])
            for view, members in zip(model.paths, model.members, strict=True)
        ]

    def score(self, batch: Sequence[SpectralFamily]) -> tuple[Floats, Floats]:
        """Score and information, shape (family, target, profile); 0 where the cause cannot affect the target."""
        model, cause, profiles = self.model, batch[0].cause, batch[0].profiles
        spectra = FamilySpectra.of(model, batch)
        score, information = np.zeros((2, len(batch), len(self.targets), len(profiles)))
        concerned = [t for t, target in enumerate(self.targets) if target.scope in cause.scopes]
        wide = [t for t in concerned if self.targets[t].has_all_antennas]
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
                has, lost = self.share[wide] @ self.of_polarisation > 0, self._lost(profiles, spectra)
                information[:, wide] -= differ[:, None, None] * np.einsum("td,dsn->stn", has, lost)
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
        families = len(spectra.values) if spectra.factors is None else len(spectra.factors)
        both = np.zeros((2, families, len(self.model.station.antenna), len(profiles)))
        for c, (view, members) in enumerate(zip(self.views, self.shown, strict=True)):
            if not members.size:
                continue
            templates = spectra.in_view(view, spectra.values[:, c : c + 1], *ALONE)
            left, whole = view.inner(templates, profiles)
            is_left = left[:, 0, 0] > SMALLEST_SHARE * whole[:, 0, 0]
            both[:, :, members] = np.stack([view.score(templates, profiles)[:, 0], left[:, 0, 0]]) * is_left
        return both[0], both[1]

    def _lost(self, profiles: Floats, spectra: FamilySpectra) -> Floats:
        """Information that deviations lose because their mean is taken out, shape (polarisation, family, profile)."""
        model = self.model
        mean = model.mean_of(spectra.values, np.ones(len(model.station.antenna), dtype=bool))
        lost = []
        for d, (view, count) in enumerate(zip(model.lost, model.paths_in_mean, strict=True)):
            templates = spectra.in_view(view, mean[:, d : d + 1], *ALONE)
            lost.append(count * view.inner(templates, profiles)[0][:, 0, 0, 0])
        return np.stack(lost)


def _count_trials(
    model: LinearModel, families: Sequence[SpectralFamily], targets: Sequence[Target], seed: int, level: float
) -> float:
    """Trials factor of one cause at a score: of its templates, for all its targets."""
    cause = families[0].cause
    copies = float(len(families)) if len(families) > MANY_SPECTRA else 1.0
    chosen = families[len(families) // 2 :][:1] if copies > 1 else families
    concerned = [target for target in targets if target.scope in cause.scopes]
    largest = int(np.argmax([len(members) for members in model.members]))
    typical = Target("path", "path", model.station.class_of == largest)
    local = [typical for target in concerned if not target.has_all_antennas]
    total = 0.0
    for alike in (local, *([target] for target in concerned if target.has_all_antennas)):
        if alike:
            total += len(alike) * trials_factor(correlate(model, chosen, alike[0]), seed, level)
    return copies * max(total, 1.0)


def refine(model: LinearModel, score: Score, policy: Policy) -> Hypothesis:
    """The hypothesis that a scan found, with the best template about the one tried, at the size to first order.

    A scan tries hours, dates and indices on a grid; `refine` scores finer templates about the best one. Templates that
    fit nearly as well have other sizes: the scatter of these sizes, weighed with the likelihoods, is part of the error.
    The likelihood of the cause is the mean over them, of which the best is one.
    """
    cause = score.cause
    conditions = model.station.conditions
    templates = cause.finer_templates(conditions, score.template)
    if len(templates) == 1:
        return Hypothesis(cause, templates[0], score.target, score.size)
    known = model.on_events(cause.known_events(conditions, score.template))
    found, scores, sizes, strengths = [], [], [], []
    for batch, z, size in score_families(known, group_templates(conditions, cause, templates), [score.target]):
        profile = batch[0].profiles
        strength = np.abs(profile).sum(axis=1) / np.maximum((profile != 0).sum(axis=1), 1)
        found += [template for family in batch for template in family.templates]
        scores.append(z[:, 0].ravel())
        sizes.append(size[:, 0].ravel())
        strengths.append(np.tile(strength, len(batch)))
    gain, size = np.concatenate(scores) ** 2, np.concatenate(sizes)
    # Power added at some hours and power missing at the others fit alike; power is added, so the size is positive.
    if np.any(size > 0) and gain[size > 0].max() > gain.max() - policy.indistinguishable:
        gain = np.where(size > 0, gain, 0.0)
    best = int(np.argmax(gain))
    # Sizes of different templates are compared by their mean effect on the events on which the template acts.
    change = size * np.concatenate(strengths)
    weight = np.exp(0.5 * (gain - gain[best])) * (np.sign(change) == np.sign(change[best]))
    scatter = np.sqrt(weight @ (change / change[best] - 1.0) ** 2 / weight.sum())
    of_all = 2.0 * float(np.log(np.mean(np.exp(0.5 * (gain - gain[best])))))
    return Hypothesis(
        cause, found[best], score.target, float(size[best]), template_sigma=float(scatter), over_templates=of_all
    )
