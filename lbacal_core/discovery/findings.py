"""The findings of a station: causes by which its model grows, and what each of them adds beside the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.growth import grow
from lbacal_core.discovery.hypothesis import Hypothesis, Rival, Target
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import AveragedSize, FittedModel, average_size, held_out_gain, refit, refit_over_noise
from lbacal_core.discovery.residual_structure import STATION
from lbacal_core.discovery.scan import (
    HiddenCause,
    Score,
    group_templates,
    list_families,
    list_hidden,
    overlap,
    refine,
    scan,
    score_families,
)
from lbacal_core.discovery.sentences import (
    CERTAIN,
    SENTENCE,
    ScoredSentence,
    likeliest_sentences,
    refine_sentence,
    score_gated,
)
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

# What spectra propose to `grow`: the best significant causes, each refined and fitted again with everything else.


@dataclass(frozen=True)
class Candidate:
    """A significant score and the model that it would make.

    Attributes
    ----------
    gain
        Gain in chi^2, averaged over the noise that the fit leaves open, less the gain that the best of so many scores
        has by chance.
    rivals
        What else was fitted in its place, and the likeliest sentence by its score.
    sentences
        Sentences beside which the cause is not likelier by far.
    """

    score: Score
    model: FittedModel
    gain: float
    rivals: Sequence[Rival] = ()
    sentences: Sequence[Hypothesis] = ()


@dataclass(frozen=True)
class SameAgain:
    """A cause that is significant a second time for the same target: its template does not have the effect's form.

    Attributes
    ----------
    number
        Number of the finding that named the cause first; negative for an adopted cause.
    """

    score: Score
    number: int


def _same_again(score: Score, hypotheses: Sequence[Hypothesis], adopted: int) -> SameAgain | None:
    for number, earlier in enumerate(hypotheses):
        is_same = earlier.cause.identifier == score.cause.identifier and earlier.target.label == score.target.label
        if is_same and not score.cause.is_another(score.template, earlier.template):
            return SameAgain(score, number - adopted)
    return None


class StationSearch:
    """The search of one station as `grow` wants it.

    Attributes
    ----------
    first_scores
        Scores of every cause before anything was added.
    again
        Why the search ended, where a cause was significant once more.
    impossible
        A score that chance does not explain, where no cause describes it with a size that it can have.
    significant
        Where the last significant score of a cause was.
    hidden
        Causes that the differences between models hide, known with the first model.
    adopted
        Number of hypotheses that the model had before the search.
    catalogue
        Every cause that a finding is compared with.
    """

    def __init__(
        self,
        station: Station,
        targets: Sequence[Target],
        policy: Policy,
        stations: int,
        seed: int,
        progress: Callable[[str], None],
        catalogue: Sequence[Cause] = CAUSES,
    ) -> None:
        self.catalogue = catalogue
        self.name, self.targets, self.policy, self.seed = station.name, targets, policy, seed
        self.stations, self.alpha, self.progress = stations, policy.catalogue_alpha / stations, progress
        self.first_scores: list[Score] = []
        self.again: SameAgain | None = None
        self.hidden: list[HiddenCause] | None = None
        self.impossible: Score | None = None
        self.significant: Target | None = None
        self.adopted = 0

    def propose(self, before: FittedModel) -> list[Candidate]:
        """The model with each of the best significant causes, fitted without linearising; none beside a full path."""
        on_paths = [one.target.is_member for one in before.hypotheses[self.adopted :]]
        if np.any(np.sum(on_paths, axis=0) >= self.policy.most_findings):
            return []
        self.progress(f"{self.name}: scoring {len(self.catalogue)} causes for {len(self.targets)} targets")
        if self.hidden is None:
            self.hidden = list_hidden(before.linear, self.catalogue, self.targets[-1], self.policy.hidden_share)
        hidden = [one.cause for one in self.hidden]
        scores = scan(before.linear, [one for one in self.catalogue if one not in hidden], self.targets, self.seed)
        self.first_scores = self.first_scores or scores
        significant = [score for score in scores if score.p_value < self.alpha]
        sentences = self._score_sentences(before, significant)
        named = self._name(before, significant, scores)
        gains = [one.gain for one in named] or [*map(_gain_beyond_chance, significant)]
        said, told = self._say(before, sentences, gains)
        beyond = 2.0 * self.policy.likelier
        best = named[0] if named else None
        of_best = self._with_second(best, said) if best and said else max(gains, default=-np.inf)
        if said is None or (best and (said.gain < of_best + beyond or self._is_alike(before, said, best))):
            spoken = [(one.hypothesis, one.gain) for one in told]
            if said is not None:
                # Scores are of the first order: what the likeliest lost as it was fitted, the others lose as well.
                lost = told[0].gain - said.gain
                spoken = [(said.model.hypotheses[-1], said.gain), *((one, gain - lost) for one, gain in spoken[1:])]
            beside = [
                replace(one, sentences=[other for other, gain in spoken if one.gain - gain < beyond]) for one in named
            ]
            # Where unseen events refuse the likeliest, what it is likelier than by far is no explanation either.
            most = max([one.gain for one in named] + [gain for _, gain in spoken], default=-np.inf)
            compared = _compare(beside, spoken[:1], of_best)
            return compared[:1] + [one for one in compared[1:] if one.gain + beyond > most]
        self.again, self.impossible = None, None
        return _compare([said, *named], [], said.gain)[:1]

    def _score_sentences(self, before: FittedModel, significant: Sequence[Score]) -> list[ScoredSentence]:
        """The likeliest sentences, for the station or where the best cause acts, by its score."""
        linear, whole = before.linear, self.targets[-1]
        best = max(significant, key=_gain_beyond_chance, default=None)
        self.significant = self.significant if best is None else best.target
        targets = [whole] if best is None or best.target.scope == STATION else [whole, best.target]
        likely = [one for target in targets for one in likeliest_sentences(linear, target, self._choices(target))]
        if best is not None:
            likely = [refine_sentence(linear, one) for one in likely]
        return sorted(likely, key=lambda one: -one.gain)

    def _say(
        self, before: FittedModel, sentences: Sequence[ScoredSentence], gains: Sequence[float]
    ) -> tuple[Candidate | None, Sequence[ScoredSentence]]:
        """The model with a sentence that is likelier by its score than every cause, if unseen events confirm it.

        Returns
        -------
        That of the first sentence, or None; and the sentences from that one on, without those that are refused.
        """
        linear, least = before.linear, max([2.0 * max(CERTAIN, -float(np.log(self.alpha))), *gains])
        for k, one in enumerate(sentences):
            if one.gain < least:
                return None, sentences[k:]
            gated = score_gated(linear, [one.target], one, self._choices(one.target))
            best = refine_sentence(linear, max(gated, key=lambda one: one.gain))
            self.progress(f"{self.name}: fitting everything again with a sentence")
            fitted = refit(before, Hypothesis(SENTENCE, best.template, best.target, best.size))
            if fitted is None or not _is_possible(fitted):
                continue
            gain, chance = gain_in_chi_squared(before, fitted) - best.length, float(np.exp(0.5 * best.length))
            events = int(before.station.is_used.sum())
            score = Score(SENTENCE, best.template, best.target, best.z, best.size, events, chance)
            said = Candidate(score, fitted, gain)
            if self.held_out_gain(before, said) > 0:
                return said, sentences[k:]
        return None, []

    def _with_second(self, named: Candidate, said: Candidate) -> float:
        """The gain of a cause, with the same once more in its target where a sentence that describes both gains more.

        Two steps of an antenna are one spell of a course as well.
        """
        cause, target = named.score.cause, named.score.target
        if said.gain < named.gain or said.score.target.label != target.label:
            return named.gain
        scores = scan(named.model.linear, [cause], [target], self.seed)
        others = [one for one in scores if cause.is_another(one.template, named.model.hypotheses[-1].template)]
        second = _fit(named.model, others[0], self.policy) if others else None
        if second is None or not _is_possible(second.model):
            return named.gain
        return named.gain + max(gain_in_chi_squared(named.model, second.model) - chance_of(named.score), 0.0)

    def _is_alike(self, before: FittedModel, said: Candidate, named: Candidate) -> bool:
        """Whether a sentence says of a target what a cause does, and fits no better: the name then tells more."""
        one, other = said.model.hypotheses[-1], named.model.hypotheses[-1]
        of_said, of_named = (gain_in_chi_squared(before, each.model) for each in (said, named))
        if one.target.label != other.target.label or of_said - of_named > self.policy.indistinguishable:
            return False
        conditions = before.station.conditions
        known = before.linear.on_events(other.cause.known_events(conditions, other.template))
        families = group_templates(conditions, other.cause, [other.template])
        ((r,),) = overlap(known, one.cause, one.template, one.target, families)
        return bool(abs(r) > self.policy.alike)

    def _choices(self, target: Target) -> int:
        """Number of targets among which one was chosen."""
        return 1 if target.scope == STATION else len(self.targets)

    def _name(self, before: FittedModel, significant: Sequence[Score], scores: Sequence[Score]) -> list[Candidate]:
        """The models with each of the best significant causes that are likelier than chance by far as they fit."""
        if significant:
            self.again = _same_again(significant[0], before.hypotheses, self.adopted)
        if not significant or self.again is not None:
            return []
        self.progress(f"{self.name}: fitting everything again with {significant[0].cause.identifier}")
        rivals = _rivals(significant, self.policy)
        possible = self._fit_possible(before, rivals)
        self.impossible = None if possible else significant[0]
        if any(one.model.noise is not None for one in possible):
            # Scores are of one share of the noise: at the share that it prefers, a cause may gain more than these.
            others = [one for one in _rivals(scores, self.policy) if all(one is not tried for tried in rivals)]
            possible += self._fit_possible(before, others)
        return sorted((one for one in possible if one.gain > 2.0 * self.policy.likelier), key=lambda one: -one.gain)

    def _fit_possible(self, before: FittedModel, scores: Sequence[Score]) -> list[Candidate]:
        """The models with each of some causes, where all sizes are physical."""
        fitted = [_fit(before, score, self.policy) for score in scores]
        return [one for one in fitted if one is not None and _is_possible(one.model)]

    def model_of(self, candidate: Candidate) -> FittedModel:
        """The fitted model of a candidate."""
        return candidate.model

    def held_out_gain(self, before: FittedModel, candidate: Candidate) -> float:
        """Gain in log-likelihood on events that were not used, the template chosen again."""
        return gain_of(before, candidate.model.hypotheses[-1], candidate.score)


def _compare(
    found: Sequence[Candidate], sentences: Sequence[tuple[Hypothesis, float]], of_first: float
) -> list[Candidate]:
    """Candidates with their rivals, the likeliest first; sentences come with what they gain beyond chance.

    With `of_first` the first of the candidates is held against sentences, with a second of its kind where that counts.
    """
    others = [(one.score.cause.identifier, one.score.target.label, one.gain) for one in found]
    said = [(SENTENCE.identifier, one.target.label, gain) for one, gain in sentences]
    return [
        replace(
            one,
            rivals=sorted(
                [
                    *(Rival(cause, target, one.gain - gain) for cause, target, gain in others[:k] + others[k + 1 :]),
                    *(Rival(cause, target, (one.gain if k else of_first) - gain) for cause, target, gain in said),
                ],
                key=lambda rival: rival.delta_chi2,
            ),
        )
        for k, one in enumerate(found)
    ]


def _gain_beyond_chance(score: Score) -> float:
    """Gain in chi^2 beyond chance, as of a sentence."""
    return score.z**2 - chance_of(score)


def chance_of(score: Score) -> float:
    """Gain in chi^2 that the best of all templates, targets and causes has by chance."""
    return 2.0 * float(np.log(score.trials * score.causes))


def _is_possible(model: FittedModel) -> bool:
    """Whether the sizes of all hypotheses lie in their physical ranges."""
    conditions = model.station.conditions
    return all(one.cause.is_physical(conditions, one.template, one.size, one.uncertainty) for one in model.hypotheses)


def _rivals(scores: Sequence[Score], policy: Policy) -> list[Score]:
    """The candidates to be fitted: the best few, without those whose scores are far below the best."""
    ranking = sorted(scores, key=lambda s: -(s.z**2 - 2 * np.log(s.trials)))
    return [s for s in ranking[: policy.rivals] if abs(s.z) > policy.rival_share * abs(ranking[0].z)]


def _fit(before: FittedModel, score: Score, policy: Policy) -> Candidate | None:
    hypothesis = refine(before.linear, score, policy)
    fitted = refit_over_noise(before, hypothesis)
    if fitted is None:
        return None
    model, over_noise = fitted
    gain = gain_in_chi_squared(before, model) + over_noise + hypothesis.over_templates
    return Candidate(score, model, gain - chance_of(score))


def chi_squared_of(before: FittedModel, after: FittedModel) -> tuple[float, float, int]:
    """Chi^2 of two models on the events and with the noise levels of the second, and its degrees of freedom."""
    chi2_after, dof = after.linear.chi_squared()
    same_events = before.linear.on_events(after.station.is_used)
    return same_events.with_levels(after.linear.residuals.levels).chi_squared()[0], chi2_after, dof


def gain_in_chi_squared(before: FittedModel, after: FittedModel) -> float:
    """By how much chi^2 is less in the second model, on its events; models that gain over the same one are rivals.

    Both leave residuals relative to the power of the first, with its noise levels and free vectors. Relative to their
    own powers, residuals of two models differ by noise times effect: by chance that is more than rivals differ by.

    Where the means alone show the cause, they alone are compared: from the deviations of the first model was taken what
    its means told of the sky and of common gains, a part of the effect, which the second would take out once more.
    """
    linear = before.linear.on_events(after.station.is_used)
    # P = m (1 + r) in each model: relative to the first, the second leaves r_before + 1 - m_after / m_before.
    of_before, of_after = 1.0 + before.baseline.residual, 1.0 + after.baseline.residual
    is_there = linear.station.is_present[:, :, None] & (of_after > 0)
    change = np.where(is_there, 1.0 - of_before / np.where(is_there, of_after, 1.0), 0.0)
    of_means = linear.shows_in_means_alone(after.hypotheses[-1].target.is_member)
    by_event = [one.chi_squared_by_event(of_means=of_means) for one in (linear, linear.with_change(change))]
    return float(by_event[0].sum() - by_event[1].sum())


def gain_of(before: FittedModel, hypothesis: Hypothesis, score: Score) -> float:
    """Gain in log-likelihood on held-out events, the time profile chosen again for the same spectral template."""
    cause, conditions = hypothesis.cause, before.station.conditions
    known = hypothesis.template.parameters
    same = {name: known[name] for name in cause.spectral_parameters if name in known}
    key = cause.spectral_key(score.template)
    alike = [one for one in cause.templates(conditions) if cause.spectral_key(one) == key]
    nearby = [hypothesis.template, *(Template({**one.parameters, **same}) for one in alike)]
    return held_out_gain(before, hypothesis, nearby)


# Causes that the data cannot tell apart from one that was found, at its size and by what they show.

HALF_ALIKE = 0.5
"""Correlation below which a template does not stand for another: it would need twice the other's score."""


def find_indistinguishable(
    model: LinearModel, hypothesis: Hypothesis, policy: Policy, catalogue: Sequence[Cause] = CAUSES
) -> list[tuple[str, float]]:
    """Causes with a template that the data cannot distinguish from the one found, with the largest such correlation.

    Beside such a template the one found adds little to chi^2, (z - r z_other)^2 / (1 - r^2). If the one found is the
    truth, this is SNR^2 (1 - r^2) on average; if the other is the truth, the data alone show it: both are asked.

    Parameters
    ----------
    model
        The residuals with everything fitted but the one found.
    """
    conditions, own, target = model.station.conditions, hypothesis.cause, hypothesis.target
    others = [cause for cause in catalogue if cause is not own and target.scope in cause.scopes]
    known = model.on_events(own.known_events(conditions, hypothesis.template))
    families = list_families(conditions, others)
    correlations = overlap(known, own, hypothesis.template, target, families)
    snr = abs(hypothesis.size / hypothesis.sigma)
    found: dict[str, float] = {}

    def add(name: str, correlation: float) -> None:
        found[name] = max(found.get(name, 0.0), correlation)

    for one, correlation in zip(families, correlations, strict=True):
        largest = float(np.abs(correlation).max())
        if snr**2 * (1 - min(largest, 1.0) ** 2) < policy.indistinguishable:
            add(one.cause.identifier, largest)
    alike = [k for k, r in enumerate(correlations) if np.abs(r).max() > HALF_ALIKE]
    ((_, z, _),) = score_families(known, group_templates(conditions, own, [hypothesis.template]), [target])
    scores = [z for _, batch, _ in score_families(known, [families[k] for k in alike], [target]) for z in batch[:, 0]]
    for k, z_other in zip(alike, scores, strict=True):
        r = np.clip(correlations[k], -1.0, 1.0)
        added = (z.item() - r * z_other) ** 2
        stands_for_it = (np.abs(r) > HALF_ALIKE) & (added < policy.indistinguishable * (1.0 - r**2))
        if np.any(stands_for_it):
            add(families[k].cause.identifier, float(np.abs(r[stands_for_it]).max()))
    return sorted(found.items(), key=lambda item: -item[1])


@dataclass(frozen=True)
class Finding:
    """A cause that these data show, with its score, its gain in chi^2 and its gain on held-out events.

    Attributes
    ----------
    indistinguishable
        Causes that fit as well at the size found, with the correlation of their templates.
    calibration_change
        Relative change of C of the target's paths, shape (path, freq).
    over_noise
        Its size averaged over the noise constants that the fit leaves open; None where the data tell them apart.
    rivals
        What was fitted in its place when it was named.
    sentences
        Sentences in its place, beside which the cause is not likelier by far.
    """

    hypothesis: Hypothesis
    score: Score
    indistinguishable: list[tuple[str, float]]
    chi2_before: float
    chi2_after: float
    dof: int
    held_out_gain: float
    calibration_change: Floats
    over_noise: AveragedSize | None = None
    rivals: Sequence[Rival] = ()
    sentences: Sequence[Hypothesis] = ()

    @property
    def size(self) -> tuple[float, float]:
        """The size with its standard deviation."""
        if self.over_noise is None:
            return self.hypothesis.size, self.hypothesis.uncertainty
        return self.over_noise.size, self.over_noise.sigma


@dataclass(frozen=True)
class Grown:
    """A model grown as far as held-out events confirm it.

    Attributes
    ----------
    others
        The last model without each of its hypotheses.
    findings
        One a hypothesis beside the adopted ones.
    """

    last: FittedModel
    others: list[FittedModel]
    findings: list[Finding]


def grow_findings(first: FittedModel, search: StationSearch) -> Grown:
    """Grow a model by one cause after the other, and take out again what adds nothing beside those found later.

    The first cause of a large effect may be another one that resembles it, before the right one is found beside it.
    """
    steps = grow(first, search, search.policy.most_of_station)
    return weigh([first, *(step.candidate.model for step in steps)], [step.candidate for step in steps], search)


def grow_by(first: FittedModel, findings: Sequence[Finding], search: StationSearch) -> Grown:
    """Grow a model by findings that are known, one after the other, without those that cannot be fitted beside it."""
    models, named = [first], list[Finding]()
    for one in findings:
        after = refit(models[-1], one.hypothesis)
        if after is not None:
            models, named = [*models, after], [*named, one]
    return weigh(models, named, search)


def weigh(models: list[FittedModel], named: Sequence[Candidate | Finding], search: StationSearch) -> Grown:
    """What each hypothesis of the last model adds beside the others, without those that add nothing.

    Parameters
    ----------
    models
        The model as it grew, from the first on.
    named
        What each model after the first was grown by.
    """
    named = list(named)
    while True:
        without = [_models_without(models, number, search.adopted) for number in range(len(named))]
        findings = [
            _finding(without[number][-1], models[-1], search.adopted + number, one, search)
            for number, one in enumerate(named)
        ]
        idle = None if search.again is not None else _idle(findings, without)
        if idle is None:
            return Grown(models[-1], [others[-1] for others in without], findings)
        models, named = without[idle], named[:idle] + named[idle + 1 :]


def _idle(findings: Sequence[Finding], without: Sequence[Sequence[FittedModel]]) -> int | None:
    """Number of the finding that adds least beside the others, if held-out events say that it adds nothing."""
    number = int(np.argmin([one.held_out_gain for one in findings])) if findings else 0
    if not findings or findings[number].held_out_gain > 0:
        return None
    beside = without[number]
    # A model that could not be fitted stands for the one before it, and lacks more than this finding.
    is_fitted = len(beside[-1].hypotheses) == len(beside[0].hypotheses) + len(beside) - 1
    return number if is_fitted else None


def _finding(
    without: FittedModel, last: FittedModel, number: int, named: Candidate | Finding, search: StationSearch
) -> Finding:
    """A finding by the last fitted model and the one without it, so that all its numbers are of one model."""
    hypothesis, score = last.hypotheses[number], named.score
    instead = [(one, refit(without, one)) for one in named.sentences]
    chi2_before, chi2_after, dof = chi_squared_of(without, last)
    return Finding(
        hypothesis=hypothesis,
        score=score,
        indistinguishable=find_indistinguishable(without.linear, hypothesis, search.policy, search.catalogue),
        chi2_before=chi2_before,
        chi2_after=chi2_after,
        dof=dof,
        held_out_gain=gain_of(without, hypothesis, score),
        calibration_change=change_of_c(without, last, hypothesis.target),
        over_noise=average_size(last, number),
        rivals=named.rivals,
        sentences=[one if model is None else model.hypotheses[-1] for one, model in instead],
    )


def _models_without(models: Sequence[FittedModel], number: int, adopted: int) -> list[FittedModel]:
    """The models that grew, without one hypothesis: the residuals of the last contain the whole effect of that one."""
    kept = list(models[: number + 1])
    for hypothesis in models[-1].hypotheses[adopted + number + 1 :]:
        kept.append(refit(kept[-1], hypothesis, models[-1].noise) or kept[-1])
    return kept


def change_of_c(before: FittedModel, after: FittedModel, target: Target) -> Floats:
    """Relative change of C of the target's paths, shape (path, freq): C is proportional to slope^(-1/2)."""
    old, new = before.baseline.solution.x[target.is_member], after.baseline.solution.x[target.is_member]
    # A slope that the noise makes negative, in the weakest channels, has no C to change.
    has_c = (old > 0) & (new > 0)
    return np.asarray(np.sqrt(np.divide(old, new, out=np.ones_like(old), where=has_c)) - 1.0)
