"""The search of one station's data for what the simulation gets wrong. Read `search_station` from top to bottom.

Fit the baseline, score every cause and the sentences of no catalogue, and fit everything again with the likeliest. It
is accepted if the likelihood of held-out events rises. Repeat on the new residuals. Then test for residual structure,
which uses no catalogue: a sentence that was accepted is structure, and a cause that it explains as well is no finding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from lbacal_core.audit.record import RecordError
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Cause, Conditions, Template, signature
from lbacal_core.causes.grammar import axis_of, parts_of
from lbacal_core.causes.model import PLAIN, Model
from lbacal_core.discovery.adopted import FittedSize, fit_adopted
from lbacal_core.discovery.antennas import AntennaScore, compare_antennas, compare_cable_names, why_no_comparison
from lbacal_core.discovery.baseline import leave_out_deaf, select_paths
from lbacal_core.discovery.describe import Described, Description, describe_structure
from lbacal_core.discovery.findings import (
    Finding,
    Grown,
    StationSearch,
    chance_of,
    gain_in_chi_squared,
    grow_by,
    grow_findings,
)
from lbacal_core.discovery.hypothesis import Hypothesis, Target, list_targets, p_of
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FittedModel, refit
from lbacal_core.discovery.residual_structure import STATION, ResidualStructure, find_structure, structure_along
from lbacal_core.discovery.scan import Score, shares_taken
from lbacal_core.discovery.sentences import SENTENCE
from lbacal_core.discovery.station import SkyModes, Station
from lbacal_core.linear import invert_symmetric

FEWEST = 3
"""Antennas that are searched without one in which structure lives: of two, each departs as the other does."""


@dataclass(frozen=True)
class StationReport:
    """What one station's data show.

    Attributes
    ----------
    deaf
        Paths that were left out, because they hardly hear the sky.
    scores, antenna_scores
        Scores of every cause on the baseline; scores of the antenna comparison beside the findings.
    description
        The residual structure in words.
    significant
        Where the last significant score of a cause was.
    said
        Sentences by which the model grew in the place of causes.
    similar
        Findings that were withdrawn, because residual structure explains the data as well.
    first, last
        The fitted model with the adopted causes alone, none in a plain model, and with all findings beside them.
    unidentifiable
        Causes that these data can never show, with the reason.
    taken
        Share of the information on each cause of the station that the vectors of the noise take. Hidden causes have
        none: rounding errors are left of them.
    stations
        Number of stations that were searched together.
    adopted
        The adopted causes with their sizes in these data.
    catalogue
        The causes that were looked for.
    record
        What was wrong with the record, which is put right in all else; and the model under the record as it was.
    rest
        The search of the other antennas, where structure in one was left and they have structure of their own.
    departure
        An antenna that departs from the others along frequency by a smooth law, where no name holds against it.
    """

    station: Station
    deaf: list[str]
    findings: list[Finding]
    antennas: list[AntennaScore]
    structure: ResidualStructure | None
    similar: list[Finding]
    scores: list[Score]
    antenna_scores: list[AntennaScore]
    first: FittedModel
    last: FittedModel
    unidentifiable: dict[str, str]
    taken: dict[str, float]
    policy: Policy
    stations: int
    adopted: Sequence[FittedSize] = ()
    record: Sequence[RecordError] = ()
    as_recorded: FittedModel | None = None
    description: Description = field(default_factory=Description)
    significant: Target | None = None
    said: Sequence[Hypothesis] = ()
    catalogue: Sequence[Cause] = CAUSES
    rest: StationReport | None = None
    departure: AntennaScore | None = None


def search_station(
    station: Station,
    *,
    modes: SkyModes | None = None,
    stations: int = 1,
    seed: int = 0,
    policy: Policy | None = None,
    progress: Callable[[str], None] = lambda _: None,
    model: Model = PLAIN,
    catalogue: Sequence[Cause] = CAUSES,
) -> StationReport:
    """Find what the simulation gets wrong in one station's data.

    Parameters
    ----------
    modes
        Relative changes of P_sky by which sky and antenna models differ, when the sky is the package's own.
    stations
        Number of stations that are searched together: they share the false-alarm rate.
    seed
        Seed of the simulated trials factors.
    progress
        Called with a sentence before each step.
    model
        The model whose adopted causes are fitted with the baseline: what is looked for is what they leave.
    catalogue
        The causes that are looked for.
    """
    policy = policy or Policy()
    station, deaf = leave_out_deaf(station)
    targets = list_targets(station)
    progress(f"{station.name}: fitting the baseline of {len(station.antenna)} paths")
    search = StationSearch(station, targets, policy, stations, seed, progress, catalogue)
    adopted = fit_adopted(station, model, modes)
    first, search.adopted = adopted.model, len(adopted.sizes)
    grown = grow_findings(first, search)
    progress(f"{station.name}: looking for structure that no cause explains")
    rng = np.random.default_rng(seed)
    said = [one for one in grown.findings if one.hypothesis.cause == SENTENCE]
    twice = None if search.again is None or search.again.number < 0 else grown.findings[search.again.number]
    if said:
        grown, structure = _name_structure(first, grown, said, search, rng)
    else:
        structure = _find_left(grown, search, rng)
    findings, similar = grown.findings, list[Finding]()
    if structure is not None:
        here = partial(_lives_there, structure=structure, conditions=station.conditions)
        is_seen = _seen_beside(first.linear, findings, structure, policy)
        similar = [
            one for one, seen in zip(findings, is_seen, strict=True) if one is twice or here(one.hypothesis) or not seen
        ]
        findings = [one for one in findings if all(one is not other for other in similar)]
    rest, others = None, None if structure is None else _leave_out(station, structure)
    ended = search.again.score if search.again else search.impossible
    hiding = [one.hypothesis.target for one in (*said, *similar)] + ([ended.target] if ended else [])
    # what is left when no score of an antenna is significant any more has hidden nothing in another
    if others is not None and not all(one.has_all_antennas for one in hiding):
        rest = search_station(
            others, modes=modes, stations=stations, seed=seed, policy=policy, progress=progress, model=model,
            catalogue=catalogue,
        )  # fmt: skip
        findings, similar = _join(findings, similar, rest, search)
    if others is not None and findings:
        # the mean to which all antennas are held would step with the one that nothing describes
        unlike = set(station.antenna.tolist()) - set(others.antenna.tolist())
        station = replace(station, apart=frozenset(unlike if rest is None else unlike | rest.station.apart))
        first = fit_adopted(station, model, modes).model
        grown = grow_by(first, findings, search)
        findings = grown.findings
    hidden = [one.cause for one in search.hidden or []]
    standing = _standing(first, grown, findings)
    changing = list[Target]()
    if structure is not None:
        shown = (*hiding, search.significant, *(one for one in targets if one.label == structure.target))
        changing = [one for one in shown if one is not None and not one.has_all_antennas]
    antenna_scores = compare_antennas(station, standing.baseline, targets, policy, seed, standing.hypotheses, changing)
    antenna_scores += compare_cable_names(standing.baseline, standing.linear, targets)
    antenna_scores.sort(key=lambda score: score.p_value)
    likely = [score for score in antenna_scores if score.p_value < policy.alpha_of_each_comparison / stations]
    return StationReport(
        station=station,
        deaf=deaf,
        findings=findings,
        antennas=[score for score in likely if score.law is None][:1],
        departure=None if any(score.law is None for score in likely) else next(iter(likely), None),
        structure=structure,
        similar=similar,
        scores=search.first_scores,
        antenna_scores=antenna_scores,
        first=first,
        last=grown.last,
        unidentifiable=_unidentifiable(station, search),
        taken=shares_taken(grown.last.linear, [one for one in catalogue if one not in hidden], targets[-1]),
        policy=policy,
        stations=stations,
        adopted=adopted.sizes,
        catalogue=catalogue,
        significant=search.significant,
        said=[one.hypothesis for one in said],
        rest=None if rest is None or rest.structure is None else rest,
    )


def put_into_words(report: StationReport, seed: int = 0) -> StationReport:
    """The report with its residual structure described, which costs as much as all else."""
    if report.structure is None:
        return _say_at_once(report, seed)
    left = _with(report.first, [one.hypothesis for one in report.findings])
    targets = list_targets(report.station)
    also = report.significant, report.said
    description = describe_structure(left, report.structure, targets, report.policy, seed, *also)
    if report.findings:
        alone = describe_structure(report.first, report.structure, targets, report.policy, seed, *also)
        standing = _stand_against(alone, description, report)
        if len(standing) < len(report.findings):
            gone = [one for one in report.findings if all(one is not other for other in standing)]
            return put_into_words(replace(report, findings=standing, similar=[*report.similar, *gone]), seed)
    rest = None if report.rest is None else put_into_words(report.rest, seed)
    first = [] if rest is None else [*description.sentences[:1], *rest.description.sentences[:1]]
    if len(first) > 1 and len({one.hypothesis.target.label for one in first}) == 1:
        rest = None  # what was seen in two antennas is said of one
    parts = [description] if rest is None else [description, rest.description]
    whole = {target.label: target for target in targets}
    said = [one.hypothesis for part in parts for one in part.sentences[:1] if one.hypothesis.target.label in whole]
    beside = [replace(one, target=whole[one.target.label]) for one in said]
    seen = [one for one in report.findings if _adds_beside(one, beside, report)]
    similar = [*report.similar, *(one for one in report.findings if all(one is not other for other in seen))]
    if len(seen) < len(report.findings):  # what was left beside a name that goes is not the structure
        return put_into_words(replace(report, findings=seen, similar=similar), seed)
    return replace(report, description=description, rest=rest)


def _stand_against(alone: Description, beside: Description, report: StationReport) -> list[Finding]:
    """The findings without those of a target of which a sentence by itself is likelier by far.

    They go together where it is likelier than they are with the sentence that is said beside them. A gain that follows
    temperature since a date is a step in autumn and a square of temperature as well. What is said of other targets
    shows elsewhere in the data, and is no rival.
    """
    if not alone.sentences:
        return report.findings
    one, others = alone.sentences[0], beside.sentences[:1]
    target = one.hypothesis.target.label
    rivals = [finding for finding in report.findings if finding.hypothesis.target.label == target]
    if not rivals or any(other.hypothesis.target.label != target for other in others):
        return report.findings
    standing = [finding for finding in report.findings if finding.hypothesis.target.label != target]
    base = _with(report.first, [finding.hypothesis for finding in standing])
    return standing if _is_likelier(one, base, rivals, others, report.policy) else report.findings


def _is_likelier(
    one: Described, base: FittedModel, rivals: Sequence[Finding], others: Sequence[Described], policy: Policy
) -> bool:
    """Whether a sentence is likelier by far than findings with sentences beside them."""
    by_itself = _with(base, [one.hypothesis])
    together = _with(base, [*(rival.hypothesis for rival in rivals), *(other.hypothesis for other in others)])
    length = sum(chance_of(rival.score) for rival in rivals) + sum(other.length for other in others)
    return gain_in_chi_squared(by_itself, together) - (length - one.length) < -2.0 * policy.likelier


def _say_at_once(report: StationReport, seed: int) -> StationReport:
    """The report of what leaves no structure, with a sentence for several causes of a target that say less likely.

    A gain of an antenna that fades since autumn is two steps, two changes of the converter's noise and a filter that
    moves, none of which leaves anything. Two steps of one gain are a failure and its repair.
    """
    for target in {one.hypothesis.target.label: one.hypothesis.target for one in report.findings}.values():
        rivals = [one for one in report.findings if one.hypothesis.target.label == target.label]
        if len({one.hypothesis.cause.identifier for one in rivals}) < 2:
            continue
        others = [one for one in report.findings if one.hypothesis.target.label != target.label]
        base = _with(report.first, [one.hypothesis for one in others])
        alpha = report.policy.structure_alpha / report.stations
        structure = find_structure(base.linear, np.random.default_rng(seed), alpha)
        if structure is None:
            continue
        said = describe_structure(base, structure, list_targets(report.station), report.policy, seed, target).sentences
        first = next((one for one in said[:1] if one.hypothesis.target.label == target.label), None)
        if first is not None and _is_likelier(first, base, rivals, [], report.policy):
            left = replace(report, findings=others, similar=[*report.similar, *rivals], structure=structure)
            return put_into_words(left, seed)
    return report


def _adds_beside(finding: Finding, sentences: Sequence[Hypothesis], report: StationReport) -> bool:
    """Whether a finding is significant beside the other findings and the sentences that describe structure.

    An antenna that echoes since a date is its digitiser's noise and a line of interference as well, where these are
    asked without the echo.
    """
    if not sentences:
        return True
    others = [one.hypothesis for one in report.findings if one is not finding]
    without = _with(report.first, [*others, *sentences])
    after = refit(without, finding.hypothesis)
    if after is None:
        return True
    z = max(gain_in_chi_squared(without, after), 0.0) ** 0.5
    return p_of(z, finding.score.trials * finding.score.causes) <= report.policy.catalogue_alpha


def _name_structure(
    first: FittedModel, grown: Grown, said: Sequence[Finding], search: StationSearch, rng: np.random.Generator
) -> tuple[Grown, ResidualStructure | None]:
    """The model with its causes alone, and the structure that the likeliest of its sentences describes."""
    kept = [number for number, one in enumerate(grown.findings) if all(one is not other for other in said)]
    findings = [grown.findings[number] for number in kept]
    kept_model = _with(first, [one.hypothesis for one in findings])
    named = Grown(kept_model, [grown.others[number] for number in kept], findings)
    best = max(said, key=lambda one: one.chi2_before - one.chi2_after)
    chance, course = best.score.p_value, parts_of(best.hypothesis.template)[2]
    linear, alpha, structure = named.last.linear, search.policy.structure_alpha / search.stations, None
    if best.hypothesis.target.has_all_antennas:
        structure = structure_along(linear, rng, alpha, axis_of(course), chance)
    return named, structure or find_structure(linear, rng, alpha, chance)


def _find_left(grown: Grown, search: StationSearch, rng: np.random.Generator) -> ResidualStructure | None:
    """Structure that is left beside the findings: for certain where a score was significant that no cause describes.

    Where a cause was significant twice, it is left beside the others: its template does not have the effect's form.
    """
    alpha, again = search.policy.structure_alpha / search.stations, search.again
    score, model = (search.impossible, grown.last) if again is None else (again.score, grown.last)
    if again is not None and again.number >= 0:
        model = grown.others[again.number]
    if score is None:
        return find_structure(model.linear, rng, alpha)
    # the means show it along its axes, unless its target is an antenna or a path
    axes = _axes_of(score.cause, score.template, model.station.conditions) if score.target.is_wide else set()
    return find_structure(model.linear, rng, alpha, score.p_value, axes)


def _leave_out(station: Station, structure: ResidualStructure) -> Station | None:
    """The station without the antenna in which structure lives; None where it does not live in one, or few are left."""
    labels = [f"antenna {a} {d}" for a, d in zip(station.antenna, station.dipole, strict=True)]
    if structure.target not in labels or structure.amounts:
        return None
    is_kept = station.antenna != station.antenna[labels.index(structure.target)]
    is_whole = np.array_equal(np.unique(station.class_of[is_kept]), np.unique(station.class_of))
    return select_paths(station, is_kept) if is_whole and np.unique(station.antenna[is_kept]).size >= FEWEST else None


def _join(
    findings: list[Finding], similar: list[Finding], rest: StationReport, search: StationSearch
) -> tuple[list[Finding], list[Finding]]:
    """The findings and those withdrawn, with what the antennas show without the one of the structure."""
    whole = {target.label: target for target in search.targets}

    def widen(one: Hypothesis) -> Hypothesis:
        return replace(one, target=whole[one.target.label])

    known = {_name(one) for one in findings}
    shown = [
        replace(one, hypothesis=widen(one.hypothesis), sentences=[widen(other) for other in one.sentences])
        for one in rest.findings
        if _name(one) not in known
    ]
    names = {_name(one) for one in shown}
    return [*findings, *shown], [one for one in similar if _name(one) not in names]


def _name(finding: Finding) -> tuple[str, str]:
    """What a finding says of whom."""
    return finding.hypothesis.cause.identifier, finding.hypothesis.target.label


def _standing(first: FittedModel, grown: Grown, findings: Sequence[Finding]) -> FittedModel:
    """The model with the findings that stand, beside which antennas are compared.

    What a withdrawn one does along frequency is divided out of its paths, and is a departure of their slopes.
    """
    return grown.last if len(findings) == len(grown.findings) else _with(first, [one.hypothesis for one in findings])


def _with(model: FittedModel, hypotheses: Sequence[Hypothesis]) -> FittedModel:
    """A model with hypotheses, one after the other."""
    for one in hypotheses:
        model = refit(model, one) or model
    return model


def _seen_beside(
    model: LinearModel, findings: Sequence[Finding], structure: ResidualStructure, policy: Policy
) -> list[bool]:
    """Whether each finding is significant beside residual structure: profiled out in the means, as it is in paths."""
    if not findings:
        return []
    beside = replace(model, empirical=structure.vectors)
    hypotheses = [finding.hypothesis for finding in findings]
    templates = [signature(one.cause, beside.terms, beside.station.conditions, one.template) for one in hypotheses]
    score, information = beside.products(templates, [one.target for one in hypotheses])
    inverse = invert_symmetric(information, share=1e-6)
    z = np.abs(inverse @ score) / np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    chances = [p_of(own, one.score.trials * one.score.causes) for own, one in zip(z.tolist(), findings, strict=True)]
    alpha, in_means = policy.catalogue_alpha * policy.beside_share, structure.vectors is not None
    on_parts = [not one.target.has_all_antennas for one in hypotheses]
    return [p <= alpha or not (in_means or part) for p, part in zip(chances, on_parts, strict=True)]


def _lives_there(one: Hypothesis, structure: ResidualStructure, conditions: Conditions) -> bool:
    """Whether the residual structure varies along an axis of a cause that was found, where it is seen.

    An effect on all antennas is seen in the means, one on an antenna in its paths, one on a cable name or a group in
    both: structure that differs from path to path is no effect on a group alone.
    """
    axes = _axes_of(one.cause, one.template, conditions)
    shown = one.target.is_wide, not one.target.has_all_antennas
    here, elsewhere = shown if structure.target == STATION else shown[::-1]
    lives_here = structure.axis is not None and structure.axis.along in axes and here
    return lives_here or (structure.elsewhere in axes and elsewhere)


def _axes_of(cause: Cause, template: Template, conditions: Conditions) -> set[str]:
    """Axes along which a cause acts: LST alone, where it acts at all times alike and the sky beside it changes."""
    is_constant = np.ptp(cause.time_profile(conditions, template)) == 0
    return {*cause.axes, "lst"} if is_constant else set(cause.axes)


def _unidentifiable(station: Station, search: StationSearch) -> dict[str, str]:
    reasons = {one.cause.identifier: one.why for one in search.hidden or []}
    seen = {score.cause.identifier for score in search.first_scores} | reasons.keys()
    for cause in search.catalogue:
        if not cause.templates(station.conditions):
            reasons[cause.identifier] = cause.needs
        elif cause.identifier not in seen:
            reasons[cause.identifier] = "the free parameters of the fit describe its signature"
    return reasons | why_no_comparison(station)
