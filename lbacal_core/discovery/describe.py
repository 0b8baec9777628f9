"""Residual structure in words: the sentences (`causes.grammar`) that describe it best, with their odds.

Every sentence has a score in the residuals. Its description length is taken from its gain in chi^2: one of a family
with many members gains more by chance. The best are varied: another law, place or course, a product with a second
course, or numbers that are estimated. The best few of all are fitted with the chain, without linearising, and asked
what they gain on unseen events.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product

import numpy as np

from lbacal_core.causes.cause import TEMPERATURE, Conditions, Template, signature
from lbacal_core.causes.grammar import PLACES, list_courses, list_laws, parts_of, rough_laws, sentence
from lbacal_core.discovery.findings import gain_in_chi_squared
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FittedModel, act_together, held_out_gain, refit
from lbacal_core.discovery.residual_structure import STATION, ResidualStructure, find_structure
from lbacal_core.discovery.scan import SpectralFamily, score_families
from lbacal_core.discovery.sentences import (
    CERTAIN,
    SENTENCE,
    ScoredSentence,
    best_of_families,
    estimate_sentence,
    gated,
    likeliest_sentences,
    list_ripples,
    move_numbers,
    places_of,
    refine_sentence,
    scatter_by_numbers,
    score_gated,
    score_interference,
    score_sentences,
    vary_sentence,
    with_one_gate_less,
)
from lbacal_core.grids import Floats

LIKELY, KEPT, FITTED = 12, 6, 4
"""Courses that are tried with all laws, sentences tried for all targets, and sentences fitted with the chain."""
ROUNDS, REFINED = 4, 4
"""Rounds in each of which a sentence is varied, or the numbers of its curve fitted; variations with moved numbers."""
SHARE = 0.5
"""Share of the gain of the best variation below which the numbers of another are not moved."""
POINTED_BY: Sequence[str] = ("sky", "polarisation", "receiver", "converter")
"""Places whose sentences choose the target for which all are tried."""
RIVAL = 3.0
"""ln of the odds below which two sentences are rivals: 1 to 20."""
FITTED_WITHIN = 5.0
"""ln of the odds below which, before the fit with the chain, a sentence may still become a rival."""
FEWEST_EVENTS = 5.0
"""Events on which a sentence must act: of fewer a course tells nothing, and they are said by themselves."""
FEWEST_ALIKE = 4
"""Antennas from which one asks whether they show a sentence by an amount that grows with their number."""


@dataclass(frozen=True)
class Described:
    """A sentence that describes residual structure.

    Attributes
    ----------
    gain
        Gain in chi^2 of the fit with it.
    length
        Its description length: what the best of as many alternatives gains by chance, chi^2.
    held_out_gain
        Gain in log-likelihood on events that were not used.
    """

    hypothesis: Hypothesis
    gain: float
    length: float
    held_out_gain: float

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds against chance."""
        return 0.5 * (self.gain - self.length)


@dataclass(frozen=True)
class Decider:
    """Spectra that would tell two sentences apart.

    Attributes
    ----------
    where
        In words.
    times
        Information of one such event over that of a typical one.
    events
        Number of such events after which the sentences differ by 3 standard deviations; None for too many.
    """

    where: str
    times: float
    events: float | None


@dataclass(frozen=True)
class Description:
    """What is said of residual structure.

    Attributes
    ----------
    sentences
        The likeliest first: that one, and its rivals.
    remains
        Structure beside the first sentence, or None where it leaves noise.
    decider
        What would tell the first two apart; None where there is one, or where no spectra could.
    amounts
        The size of the first sentence in each antenna, with its error, where an antenna shows it most.
    """

    sentences: Sequence[Described] = ()
    remains: ResidualStructure | None = None
    decider: Decider | None = None
    amounts: dict[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def grows_with_number(self) -> float | None:
        """Correlation of the amounts with the numbers of the antennas; None where there are too few."""
        if len(self.amounts) < FEWEST_ALIKE:
            return None
        return float(np.corrcoef(list(self.amounts), [size for size, _ in self.amounts.values()])[0, 1])


def describe_structure(
    model: FittedModel,
    structure: ResidualStructure,
    targets: Sequence[Target],
    policy: Policy,
    seed: int = 0,
    also: Target | None = None,
    said: Sequence[Hypothesis] = (),
) -> Description:
    """Describe the structure which a model leaves; `Description()` where no sentence does better than chance.

    Sentences are tried where the structure is seen and, where they say more of that, where something was significant
    (`also`); those which the search said (`said`) are tried, too.
    """
    seen = [one for one in targets if one.label == structure.target]
    seen += [one for one in targets if one.scope == "antenna" and seen and np.all(one.is_member >= seen[0].is_member)]
    seen += [one for one in targets if one.scope == "dipole" and structure.target == STATION]
    seen += [also] if also is not None and all(one.label != also.label for one in seen) else []
    if not seen:
        return Description()
    likely = _search(model.linear, seen, targets, said)
    order = sorted(_fit_likely(model, likely, len(targets)), key=lambda one: -one[0].log_odds)
    certain = [one for one, _ in order if one.log_odds > CERTAIN and one.held_out_gain > 0.0]
    if not certain:
        return Description()
    after = next(one for described, one in order if described is certain[0])
    rivals = [one for one in certain if certain[0].log_odds - one.log_odds < RIVAL]
    alpha, rng = policy.structure_alpha, np.random.default_rng(seed)
    return Description(
        rivals,
        find_structure(after.linear, rng, alpha),
        _what_decides(model.linear, rivals[0], rivals[1]) if len(rivals) > 1 else None,
        {} if structure.target == STATION else _amounts(model.linear, rivals[0], targets),
    )


# The search: all courses with a few laws, all laws with the best courses, then one part after the other of the best.


def _search(
    model: LinearModel, seen: Sequence[Target], targets: Sequence[Target], said: Sequence[Hypothesis]
) -> list[ScoredSentence]:
    """The likeliest sentences of different families, for the target that shows them best."""
    conditions, choices = model.station.conditions, len(targets)
    noticed = [likeliest_sentences(model, one, choices, POINTED_BY)[0] for one in seen] if len(seen) > 1 else []
    whole = max(noticed, key=lambda one: one.gain).target if noticed else seen[0]
    places = [name for name in places_of(whole, conditions) if not PLACES[name].moves]
    spectra = [*product(places, rough_laws(conditions)), *list_ripples(conditions)]
    rough = score_sentences(model, [whole], spectra, list_courses(conditions), choices)
    likely = list(dict.fromkeys(parts_of(one.template)[2] for one in best_of_families(rough)))[:LIKELY]
    spectra = list(product(places, list_laws(conditions)))
    found = score_sentences(model, [whole], spectra, likely, choices)
    moving = [name for name in places_of(whole, conditions) if PLACES[name].moves]
    found += score_sentences(model, [whole], list(product(moving, rough_laws(conditions))), [("always",)], choices)
    found += score_interference(model, whole, choices)
    single = _best_physical(model, found)
    found = list(single)
    for one in single[:KEPT]:
        place, law, course = parts_of(one.template)
        told = [target for target in targets if place in places_of(target, conditions)]
        found += score_sentences(model, told, [(place, law)], [course], choices)
    for hypothesis in said:
        place, law, course = parts_of(hypothesis.template)
        found += score_sentences(model, [hypothesis.target], [(place, law)], [course], choices)
    for one in _best_physical(model, found)[:KEPT]:
        found += score_gated(model, [one.target], one, choices)
    pool = [refine_sentence(model, one) for one in _best_physical(model, found)[:KEPT]]
    tried = list[Template]()
    while len(tried) < ROUNDS:
        best = _best_physical(model, pool)
        known = {own.family: own.gain for own in best}
        start = next((own for own in _best_of_places(best) if own.template not in tried), None)
        if start is None:
            break
        tried.append(start.template)
        others = [*vary_sentence(model, start, choices), *estimate_sentence(model, start, choices)]
        varied = _best_physical(model, others)
        worth = [other for other in varied[:REFINED] if other.gain > known.get(other.family, SHARE * varied[0].gain)]
        pool += [refine_sentence(model, other) for other in worth]
    lasting = [one for one in pool if _count_events(conditions, one.template) >= FEWEST_EVENTS]
    return _best_physical(model, lasting)


def _best_physical(model: LinearModel, scored: Sequence[ScoredSentence]) -> list[ScoredSentence]:
    """The best of each family whose size to first order is physical, the likeliest first."""
    possible = [one for one in scored if _is_physical_to_first_order(model.station.conditions, one.hypothesis)]
    return best_of_families(possible)


def _is_physical_to_first_order(conditions: Conditions, one: Hypothesis) -> bool:
    """Whether a size to first order is physical, of some paths also where their chains took up nothing of the change.

    Gains are of a path, noise constants of the station: what the converter of one antenna adds at night, as much as 7.5
    times its noise, leaves them as they are.
    """
    forms = (True,) if one.target.has_all_antennas else (True, False)
    own = conditions, one.template, one.size, one.sigma
    return any(SENTENCE.is_physical(*own, is_first_order=form) for form in forms)


def _count_events(conditions: Conditions, template: Template) -> float:
    """Number of events on which a sentence acts: of the squares of its course the squared sum over that of squares."""
    course = SENTENCE.time_profile(conditions, template)
    square = (course / np.abs(course).max()) ** 2
    return float(np.sum(square) ** 2 / np.sum(square**2))


def _best_of_places(sentences: Sequence[ScoredSentence]) -> list[ScoredSentence]:
    """The likeliest sentence for each target and place, the likeliest first."""
    best: dict[tuple[str, str], ScoredSentence] = {}
    for one in sentences:
        best.setdefault((one.target.label, parts_of(one.template)[0]), one)
    return list(best.values())


def _without_idle(model: FittedModel, one: ScoredSentence, choices: int) -> ScoredSentence:
    """The sentence without a condition that gains nothing on unseen events, the condition chosen again for each fold.

    Where an effect differs from event to event, as bursts do, the best of many conditions keeps a few large events.
    """
    conditions, (place, law, course) = model.station.conditions, parts_of(one.template)
    for less in with_one_gate_less(course):
        with_it = [sentence(place, law, own) for own in gated(conditions, less)]
        plain = sentence(place, law, less)
        if held_out_gain(model, one.hypothesis, with_it) <= held_out_gain(model, one.hypothesis, [plain]):
            (scored,) = score_sentences(model.linear, [one.target], [(place, law)], [less], choices)
            return _without_idle(model, refine_sentence(model.linear, scored), choices)
    return one


def _fit_likely(
    before: FittedModel, likely: Sequence[ScoredSentence], choices: int
) -> list[tuple[Described, FittedModel]]:
    """Fit the likeliest sentence of each place and target, of those hardly less likely than the first that has a size.

    Where one has none, the next of its place takes its turn.
    """
    fitted: dict[tuple[str, str], tuple[Described, FittedModel]] = {}
    least = -np.inf
    for one in likely:
        place = one.target.label, parts_of(one.template)[0]
        if len(fitted) == FITTED or one.gain <= least:
            break
        shorter = one if place in fitted else _without_idle(before, one, choices)
        found = None if place in fitted or shorter.gain <= least else _fit(before, shorter)
        if found is not None:
            fitted[place] = found
            least = max(least, shorter.gain - 2.0 * FITTED_WITHIN)
    return list(fitted.values())


def _fit(before: FittedModel, one: ScoredSentence) -> tuple[Described, FittedModel] | None:
    """The sentence fitted with the chain, and the model with it; None where no size that is physical fits."""
    after = refit(before, Hypothesis(SENTENCE, one.template, one.target, one.size))
    if after is None:
        return None
    after, gain = _fit_numbers(before, after)
    hypothesis = after.hypotheses[-1]
    conditions = before.station.conditions
    if not SENTENCE.is_physical(conditions, hypothesis.template, hypothesis.size, hypothesis.uncertainty):
        return None
    held_out = held_out_gain(before, hypothesis, [hypothesis.template])
    scatter = np.hypot(hypothesis.template_sigma, scatter_by_numbers(before.linear, one))
    hypothesis = replace(hypothesis, template_sigma=float(scatter))
    return Described(hypothesis, gain, one.length, held_out), after


def _fit_numbers(before: FittedModel, after: FittedModel) -> tuple[FittedModel, float]:
    """The model with the numbers of a curve of its last hypothesis fitted beside its size, and its gain in chi^2."""
    gain = gain_in_chi_squared(before, after)
    for _ in range(ROUNDS):
        *others, one = after.hypotheses
        moved = move_numbers(after.linear, act_together(after.station, after.baseline.terms, others), one)
        tried = None if moved is None else refit(before, moved)
        more = gain if tried is None else gain_in_chi_squared(before, tried)
        if moved is not None:
            one = replace(one, template_sigma=moved.template_sigma)
        if tried is None or more <= gain:
            return replace(after, hypotheses=[*others, one]), gain
        after, gain = tried, more
    return after, gain


# What is said beside the sentences: how much of it each antenna shows, and what would tell two of them apart.


def _amounts(model: LinearModel, one: Described, targets: Sequence[Target]) -> dict[int, tuple[float, float]]:
    """The size of a sentence in each antenna, to first order, with its error."""
    conditions, template = model.station.conditions, one.hypothesis.template
    antennas = [target for target in targets if target.scope == "antenna"]
    if not antennas:
        return {}
    family = SpectralFamily(SENTENCE, [template], SENTENCE.time_profile(conditions, template).T)
    known = model.on_events(family.known_events(conditions))
    ((_, z, size),) = score_families(known, [family], antennas)
    numbers = [int(model.station.antenna[target.is_member][0]) for target in antennas]
    seen = zip(numbers, size.ravel().tolist(), z.ravel().tolist(), strict=True)
    return {number: (own, abs(own / score)) for number, own, score in seen if score}


PARTS = 6
"""Parts of an axis among which one looks for the spectra that tell most."""
MOST_TIMES = 10
"""Events that nobody can wait for, over those at hand: those of ten years where these are of one."""


def _what_decides(model: LinearModel, one: Described, other: Described) -> Decider | None:
    """The part of an axis in which an event tells two sentences apart best, of what the free vectors leave."""
    conditions = model.station.conditions
    shown = [
        own.hypothesis.size * signature(SENTENCE, model.terms, conditions, own.hypothesis.template)
        for own in (one, other)
    ]
    target, change = one.hypothesis.target, shown[0] - shown[1]
    if target.is_wide:
        view, member, seen = model.common, 0, model.mean_of(change, target.is_member)
    else:
        path = int(np.flatnonzero(target.is_member)[0])
        c = int(model.station.class_of[path])
        view, member, seen = model.paths[c], int(np.flatnonzero(model.members[c] == path)[0]), change[c : c + 1]
    clean, is_there = view.clean(seen, member), view.weight[member] > 0
    by_event = np.einsum("ref,ref->e", clean, view.weigh(clean)) * view.weight[member]
    if not by_event.sum() > 0.0:
        return None
    candidates = []
    for values, words in _axes_of(conditions):
        known = np.isfinite(values) & is_there
        for low, high in pairwise(np.quantile(values[known], np.linspace(0.0, 1.0, PARTS + 1))):
            inside = known & (values >= low) & (values <= high)
            candidates.append((float(by_event[inside].mean()), words.format(low, high)))
    most, where = max(candidates)
    events = 9.0 / most
    reached = events if events <= MOST_TIMES * is_there.sum() else None
    return Decider(where, most / float(by_event[is_there].mean()), reached)


def _axes_of(conditions: Conditions) -> list[tuple[Floats, str]]:
    """Axes along which an operator can choose, with words."""
    found = [
        (conditions.lst_hours, "between {0:.1f} and {1:.1f} h LST"),
        (conditions.utc_hours, "between {0:.1f} and {1:.1f} h UTC"),
    ]
    warmth = conditions.covariate(TEMPERATURE)
    return found if warmth is None else [*found, (warmth, "at {0:.0f} to {1:.0f} degrees C")]
