"""What does the simulation get wrong in these data? Read `investigate_station` from top to bottom.

Fit the baseline; score every cause; take the best, fit everything again with it, keep it if data not used become more
probable; repeat on what is left; then ask without a catalogue whether anything is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cable import log_loss_per_metre
from lbacal_core.causes.catalogue import CAUSES, NEVER_HERE, STATIC_CAUSES
from lbacal_core.causes.terms import Law, signature
from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.chance import p_of
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.extend import Effect, Extension, fit_extension, fit_plain, held_out_gain
from lbacal_core.discovery.leftover import Leftover, find_leftover, share_of_channels
from lbacal_core.discovery.refine import refine
from lbacal_core.discovery.scan import INDISTINGUISHABLE, Score, correlate_with, scan
from lbacal_core.discovery.statics import FEWEST_COMPARISONS, StaticScore, count_comparisons, scan_static
from lbacal_core.discovery.targets import Target, list_targets
from lbacal_core.grids import Floats

FALSE_ALARM_RATE = 0.005
"""Probability of anything but `consistent` where nothing is hidden, shared among the three questions below."""
ALPHA_CATALOGUE, ALPHA_STATIC, ALPHA_LEFTOVER = 0.0025, 0.0005, 0.002
MAX_FINDINGS = 5
STILL_SEEN = 0.05
"""Probability by chance below which a finding stands beside structure that has no name."""
SAME_SPECTRUM = 0.8
"""Overlap (Bhattacharyya) of two spectra, each the share of the whitened structure in every channel, to be alike."""
RIVALS = 4
"""Candidates that are fitted without linearising before one is named."""


@dataclass(frozen=True)
class Finding:
    """A cause that these data show, with the evidence."""

    effect: Effect
    score: Score
    p_value: float
    significance: float
    indistinguishable: list[tuple[str, float]]
    chi2_before: float
    chi2_after: float
    dof: int
    held_out_gain: float
    held_out_events: int
    calibration_change: Floats


@dataclass(frozen=True)
class StationReport:
    """What one station's data say.

    Attributes
    ----------
    first_scan, static_scan
        The scores of every cause before anything was added, and of static ones after, for the report.
    similar
        Causes that resemble structure that none explains.
    """

    data: StationData
    findings: list[Finding]
    static: list[StaticScore]
    leftover: Leftover | None
    similar: list[Finding]
    first_scan: list[Score]
    static_scan: list[StaticScore]
    first: Extension
    last: Extension
    unidentifiable: dict[str, str]


def investigate_station(
    data: StationData,
    *,
    modes: Floats | None = None,
    stations: int = 1,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> StationReport:
    """Find what the simulation gets wrong in one station's data.

    Parameters
    ----------
    modes
        Relative changes of P_sky by which sky and antenna models differ, when the sky is the package's own.
    stations
        Number of stations that are asked the same question: shares the false-alarm rate.
    seed
        Of the look-elsewhere simulation.
    progress
        Told each step.
    """
    targets = list_targets(data)
    progress(f"{data.station}: fitting the baseline of {len(data.antenna)} paths")
    models = [fit_plain(data, modes)]
    progress(f"{data.station}: scoring {len(CAUSES)} causes for {len(targets)} targets")
    scores = first_scan = scan(models[0].evidence, CAUSES, targets, seed)
    findings: list[Finding] = []
    misfit: Misfit | None = None
    while len(findings) < MAX_FINDINGS:
        significant = [s for s in scores if s.p_value < ALPHA_CATALOGUE / stations]
        if not significant:
            break
        misfit = _find_misfit(significant[0], findings)
        if misfit is not None:
            break
        progress(f"{data.station}: fitting everything again with {significant[0].cause.identifier}")
        found = _extend(data, models[-1], significant, modes)
        if found is None:
            break
        models.append(found[0])
        findings.append(found[1])
        progress(f"{data.station}: scoring what is left")
        scores = scan(models[-1].evidence, CAUSES, targets, seed)
    # Every size is that of the last fit.
    findings = [replace(f, effect=effect) for f, effect in zip(findings, models[-1].effects, strict=True)]
    static_scan = scan_static(data, models[-1].baseline, targets, seed)
    progress(f"{data.station}: looking for structure that no cause explains")
    asked = models[-1] if misfit is None else _without(data, models, misfit.number, modes)
    chance = None if misfit is None else misfit.score.p_value
    leftover = find_leftover(asked.evidence, np.random.default_rng(seed), ALPHA_LEFTOVER / stations, chance)
    similar = [] if leftover is None else _not_on_their_own(models[0], findings, leftover, misfit)
    return StationReport(
        data=data,
        findings=[f for f in findings if not any(f is one for one in similar)],
        static=[score for score in static_scan[:1] if score.p_value < ALPHA_STATIC / stations],
        leftover=leftover,
        similar=similar,
        first_scan=first_scan,
        static_scan=static_scan,
        first=models[0],
        last=models[-1],
        unidentifiable=_unidentifiable(data, first_scan),
    )


@dataclass(frozen=True)
class Candidate:
    """A significant score and the model that it would make."""

    score: Score
    model: Extension
    chi2_before: float
    chi2_after: float
    dof: int

    @property
    def effect(self) -> Effect:
        """The effect added."""
        return self.model.effects[-1]

    @property
    def gain(self) -> float:
        """Chi^2 gained, less what the best of so many scores gains by chance."""
        return self.chi2_before - self.chi2_after - 2 * float(np.log(self.score.trials))


def _extend(
    data: StationData, before: Extension, significant: Sequence[Score], modes: Floats | None
) -> tuple[Extension, Finding] | None:
    """The model extended by the candidate that fits best without linearising, if held-out data agree."""
    candidates = [one for score in _rivals(significant) if (one := _fit_candidate(data, before, score, modes))]
    for best in sorted(candidates, key=lambda one: -one.gain):
        effect = best.effect
        held_out, events = held_out_gain(before, effect, _nearby_laws(effect, best.score.law, data))
        if held_out > 0:
            return best.model, Finding(
                effect=effect,
                score=best.score,
                p_value=best.score.p_value,
                significance=best.score.significance,
                indistinguishable=find_similar(before.evidence, effect),
                chi2_before=best.chi2_before,
                chi2_after=best.chi2_after,
                dof=best.dof,
                held_out_gain=held_out,
                held_out_events=events,
                calibration_change=_calibration_change(before, best.model, effect.target),
            )
    return None


def _rivals(significant: Sequence[Score]) -> list[Score]:
    """The best few candidates; those far behind the best cannot win by a better fit."""
    ranking = sorted(significant, key=lambda s: -(s.z**2 - 2 * np.log(s.trials)))
    return [s for s in ranking[:RIVALS] if abs(s.z) > 0.6 * abs(ranking[0].z)]


def _fit_candidate(data: StationData, before: Extension, score: Score, modes: Floats | None) -> Candidate | None:
    model = fit_extension(data, before, refine(before.evidence, score), modes)
    if model is None:
        return None
    chi2_after, dof = model.evidence.chi_squared()
    chi2_before, _ = before.evidence.with_levels(model.residuals.levels).chi_squared()
    return Candidate(score, model, chi2_before, chi2_after, dof)


def _nearby_laws(effect: Effect, tried: Law, data: StationData) -> list[Law]:
    """The laws among which the held-out test chooses again: those that do the same at another time."""
    cause = effect.cause
    same = {name: effect.law.parameters[name] for name in cause.shaped_by}
    laws = [law for law in cause.laws(data.conditions) if cause.shape_of(law) == cause.shape_of(tried)]
    return [effect.law, *(Law({**law.parameters, **same}) for law in laws)]


@dataclass(frozen=True)
class Misfit:
    """A cause that is wanted again for the same target, though one of its kind would have done it all.

    Attributes
    ----------
    number
        Of the finding that named it first: structure that it describes badly.
    """

    score: Score
    number: int


def _find_misfit(score: Score, findings: Sequence[Finding]) -> Misfit | None:
    for number, earlier in enumerate(finding.effect for finding in findings):
        is_same = earlier.cause is score.cause and earlier.target.label == score.target.label
        if is_same and not score.cause.is_another(score.law, earlier.law):
            return Misfit(score, number)
    return None


def _without(data: StationData, models: Sequence[Extension], number: int, modes: Floats | None) -> Extension:
    """The model with all effects but one, whose structure is to be looked at whole."""
    model = models[number]
    for effect in models[-1].effects[number + 1 :]:
        model = fit_extension(data, model, effect, modes) or model
    return model


def find_similar(evidence: Evidence, effect: Effect) -> list[tuple[str, float]]:
    """Causes whose signature, under some law, cannot be told from this one at the size found, with the correlation."""
    others = [cause for cause in CAUSES if cause is not effect.cause and effect.target.scope in cause.scopes]
    snr = abs(effect.size / effect.sigma)
    found: dict[str, float] = {}
    for cause, largest in correlate_with(evidence, effect.cause, effect.law, effect.target, others):
        if snr**2 * (1 - min(largest, 1.0) ** 2) < INDISTINGUISHABLE:
            found[cause.identifier] = max(found.get(cause.identifier, 0.0), largest)
    return sorted(found.items(), key=lambda item: -item[1])


def _calibration_change(before: Extension, after: Extension, target: Target) -> Floats:
    """Relative change of C of the paths concerned, shape (path, freq): C goes as the slope to the power -1/2."""
    old, new = before.baseline.solution.x[target.is_member], after.baseline.solution.x[target.is_member]
    # A slope that the noise makes negative, in the weakest channels, has no C to change.
    has_c = (old > 0) & (new > 0)
    return np.asarray(np.sqrt(np.divide(old, new, out=np.ones_like(old), where=has_c)) - 1.0)


def _not_on_their_own(
    first: Extension, findings: Sequence[Finding], leftover: Leftover, misfit: Misfit | None
) -> list[Finding]:
    """Findings that structure without a name may explain as well: they resemble it, and are no names for it."""
    is_seen = _seen_beside(first.evidence, findings, leftover)
    return [
        finding
        for number, finding in enumerate(findings)
        if (misfit is not None and number == misfit.number)
        or _lives_there(finding, leftover)
        or _has_its_spectrum(first.evidence, finding, leftover)
        or not is_seen[number]
    ]


def _seen_beside(evidence: Evidence, findings: Sequence[Finding], leftover: Leftover) -> list[bool]:
    """Whether each finding is still seen when the empirical term of what is left counts as absorbed."""
    if leftover.vectors is None or not findings:
        return [True] * len(findings)
    beside = replace(evidence, empirical=leftover.vectors)
    conditions = beside.data.conditions
    signatures = [signature(f.effect.cause, beside.terms, conditions, f.effect.law) for f in findings]
    score, information = beside.products(signatures, [f.effect.target for f in findings])
    inverse = np.linalg.pinv(information, rcond=1e-6, hermitian=True)
    z = np.abs(inverse @ score) / np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    trials = [finding.score.trials * finding.score.causes for finding in findings]
    return [p_of(own, many) <= STILL_SEEN for own, many in zip(z.tolist(), trials, strict=True)]


def _has_its_spectrum(evidence: Evidence, finding: Finding, leftover: Leftover) -> bool:
    """Whether structure in single events is left with the spectrum of the finding's signature."""
    effect = finding.effect
    if leftover.axis != "event" or effect.target.scope not in ("station", "cable"):
        return False
    shown = signature(effect.cause, evidence.terms, evidence.data.conditions, effect.law)
    own = share_of_channels(evidence, evidence.mean_of(shown, effect.target.is_member))
    return float(np.sum(np.sqrt(own * leftover.channel_share))) > SAME_SPECTRUM


def _lives_there(finding: Finding, leftover: Leftover) -> bool:
    """Whether structure is left along an axis of the finding's signature, for the same kind of target."""
    axis = leftover.axis.split(",", maxsplit=1)[0]
    is_wide = finding.effect.target.scope in ("station", "cable")
    return axis in finding.effect.cause.axes and is_wide == (leftover.target == "station")


def _unidentifiable(data: StationData, scores: Sequence[Score]) -> dict[str, str]:
    reasons = dict(NEVER_HERE)
    seen = {score.cause.identifier for score in scores}
    for cause in CAUSES:
        if not cause.laws(data.conditions):
            reasons[cause.identifier] = cause.needs
        elif cause.identifier not in seen:
            reasons[cause.identifier] = "what the fit leaves free absorbs its signature"
    cables = dict(zip(data.conditions.cables, np.exp(data.conditions.cable_log_loss), strict=True))
    for static in STATIC_CAUSES:
        why = static.why_not(log_loss_per_metre(cables))
        if why is None and count_comparisons(data) < FEWEST_COMPARISONS:
            why = "needs more antennas of the same cable name to compare"
        if why is not None:
            reasons[static.identifier] = why
    return reasons
