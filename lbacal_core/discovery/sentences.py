"""Sentences (`causes.grammar`) scored in residuals, with what the best of so many gains by chance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise, product
from math import comb
from typing import Any

import numpy as np

from lbacal_core.causes.cause import Conditions, Template, spectral_signature
from lbacal_core.causes.grammar import (
    CHANNELS,
    COURSES,
    CURVE,
    LAWS,
    PLACES,
    PRODUCT,
    SERIES,
    Form,
    Sentence,
    channels_of,
    columns_of,
    course_of,
    law_of,
    list_courses,
    list_laws,
    opposite,
    parts_of,
    rough_laws,
    sentence,
    smooth_along_band,
    smooth_in_time,
)
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.scan import SpectralFamily, group_templates, score_families, score_in_means, score_in_path
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.linear import invert_symmetric

SENTENCE, OF_CHANNELS = Sentence(), Sentence(by_channel=True)
NOTICED_AT: Sequence[str] = ("sky", "antenna", "front", "receiver", "converter")
NOTICED_BY = 5
"""Places, and the number of laws, by which sentences are noticed: a quarter of the cost of a scan of the catalogue."""
RIPPLED: Sequence[str] = ("front", "converter")
"""Places at which ripples are tried with all courses: they look alike at others."""
OTHER_GATES: Sequence[str] = ("near", "sky")
"""Courses with which a product is tried beside those that are 0 or 1."""
INTERFERES_AT, INTERFERES_WHEN = "antenna", ("step", "hours", "day", "night", "working days", "weekend")
"""The place at which interference is told, and courses by which it is noticed."""
MOST_CHANNELS, WORTH_JOINING = 20, 0.5
"""Channels of one sentence; and the share of its description length that the best of them must gain by itself."""
TRIED = 3
"""Sentences whose numbers are moved before one is held against a cause."""
SHARES_OF_STEP = (1.0, 1.0, 0.5, 0.25)
"""Shares of the steps of the grid by which numbers are moved, one after the other."""
CERTAIN = 7.0
"""ln of the odds against chance from which a sentence is said: 1 in 1000, as for a cause of the catalogue."""


@dataclass(frozen=True)
class ScoredSentence:
    """A sentence for a target, with its score and what the best of as many alternatives gains by chance, chi^2."""

    template: Template
    target: Target
    z: float
    size: float
    length: float

    @property
    def gain(self) -> float:
        """Gain in chi^2 beyond chance: twice the ln of its odds."""
        return self.z**2 - self.length

    @property
    def hypothesis(self) -> Hypothesis:
        """The sentence with its size and error to first order."""
        return Hypothesis(
            SENTENCE, self.template, self.target, self.size, abs(self.size / self.z) if self.z else np.inf
        )

    @property
    def family(self) -> tuple[str, ...]:
        """Target, place, and the names of law and course: what rivals differ by."""
        place, law, course = parts_of(self.template)
        return self.target.label, place, law[0], *sorted(names_in(course))


def likeliest_sentences(
    model: LinearModel, target: Target, choices: int = 1, places: Sequence[str] = NOTICED_AT
) -> list[ScoredSentence]:
    """The likeliest sentences of different families for a target, of few laws and places, ripples, and all courses."""
    conditions = model.station.conditions
    told = [place for place in places if place in places_of(target, conditions)]
    spectra = [*product(told, rough_laws(conditions)[:NOTICED_BY]), *list_ripples(conditions)]
    found = score_sentences(model, [target], spectra, list_courses(conditions), choices)
    return best_of_families([*found, *score_interference(model, target, choices)])[:TRIED]


def score_interference(model: LinearModel, target: Target, choices: int = 1) -> list[ScoredSentence]:
    """Power added in single channels with the course of each name that shows most, in the channels that follow it.

    Interference has no negative power: all channels have more of it, or less, together.
    """
    conditions = model.station.conditions
    laws = [(CHANNELS, float(one), 1.0) for one in conditions.frequency_mhz]
    spectra = [(INTERFERES_AT, law) for law in laws]
    courses = [one for one in list_courses(conditions) if one[0] in INTERFERES_WHEN]
    single = score_sentences(model, [target], spectra, courses, choices, OF_CHANNELS)
    found, length = list[ScoredSentence](), Lengths(conditions, choices)
    for one in _best_by_course(single):
        if one.gain < -WORTH_JOINING * one.length:
            break
        alike = score_sentences(model, [target], spectra, [parts_of(one.template)[2]], choices, OF_CHANNELS)
        same = [other for other in alike if np.sign(other.size) == np.sign(one.size)]
        order = sorted(same, key=lambda other: -(other.z**2))[:MOST_CHANNELS]
        found.append(_join_channels(model, order, length))
    return found


def _with_values(at_mhz: Sequence[float], values: Sequence[float]) -> Form:
    """The law of interference in channels."""
    return (CHANNELS, *chain.from_iterable(zip(at_mhz, values, strict=False)))


def _join_channels(model: LinearModel, order: Sequence[ScoredSentence], length: Lengths) -> ScoredSentence:
    """Sentences of single channels as one of the first of them, as many as gain more than their description length."""
    first, (place, _, course) = order[0], parts_of(order[0].template)
    known = model.on_events(SENTENCE.known_events(model.station.conditions, first.template))
    conditions, at = known.station.conditions, [parts_of(one.template)[1][1] for one in order]
    shown = spectral_signature(SENTENCE, known.terms, conditions, sentence(place, ("flat",), ("always",)))
    shown = shown * SENTENCE.time_profile(conditions, first.template)
    score, information = known.products([shown * one for one in channels_of(conditions, at)], [first.target] * len(at))
    best = first
    for count in range(2, len(order) + 1):
        size = invert_symmetric(information[:count, :count], share=1e-6) @ score[:count]
        gain = max(float(size @ score[:count]), 1.0)
        values, scale = _in_units(size, np.eye(count), is_signed=True)
        law = _with_values(at, values)
        whole = length.spectral(law, gain) + length.temporal(course, gain)
        tried = ScoredSentence(sentence(place, law, course), first.target, gain**0.5, scale, whole)
        best = tried if tried.gain > best.gain and min(values) > 0.0 else best
    return best


def list_ripples(conditions: Conditions) -> list[tuple[str, Form]]:
    """Ripples at the places at which they are tried with all courses."""
    return list(product(RIPPLED, (law for law in list_laws(conditions) if law[0] == "ripple")))


def names_in(course: Form) -> tuple[str, ...]:
    """Names of a course, of a product those of both, with what it follows."""
    if course[0] == PRODUCT:
        return (*names_in(course[1]), *names_in(course[2]))
    return course[:2] if course[0] in (SERIES, "wave", "near", "column", "over", "under") else course[:1]


def score_sentences(
    model: LinearModel,
    targets: Sequence[Target],
    spectra: Sequence[tuple[str, Form]],
    courses: Sequence[Form],
    choices: int = 1,
    cause: Sentence = SENTENCE,
) -> list[ScoredSentence]:
    """The best course of each name for every place and law, with its target; of `choices` if that was chosen before."""
    conditions, found = model.station.conditions, list[ScoredSentence]()
    length = Lengths(conditions, max(len(targets), choices))
    by_events: dict[bytes, dict[tuple[str, ...], list[Form]]] = {}
    for course in courses:
        on_events = by_events.setdefault(conditions.known_events(*columns_of(course)).tobytes(), {})
        on_events.setdefault(names_in(course), []).append(course)
    for by_name in by_events.values():
        alike = [one for own in by_name.values() for one in own]
        profiles = np.stack([course_of(conditions, one) for one in alike])
        families = [SpectralFamily(cause, [sentence(*spectrum, alike[0])], profiles) for spectrum in spectra]
        known = model.on_events(families[0].known_events(conditions))
        of_course = np.array([length.temporal(one, 1.0) for one in alike])
        ends = np.cumsum([0, *(len(own) for own in by_name.values())]).tolist()
        for batch, z, size in _scores(known, families, targets):
            for (s, family), (begin, end) in product(enumerate(batch), pairwise(ends)):
                worth = z[s, :, begin:end] ** 2 - of_course[begin:end]
                t, at = (int(one) for one in np.unravel_index(int(np.argmax(worth)), worth.shape))
                k = begin + at
                place, law, _ = parts_of(family.templates[0])
                own = (float(z[s, t, k]), float(size[s, t, k]))
                whole = length.spectral(law, own[0] ** 2) + length.temporal(alike[k], own[0] ** 2)
                found.append(ScoredSentence(sentence(place, law, alike[k]), targets[t], *own, whole))
    return found


def _scores(
    model: LinearModel, families: Sequence[SpectralFamily], targets: Sequence[Target]
) -> list[tuple[Sequence[SpectralFamily], Floats, Floats]]:
    """Scores of families: of one path or all antennas alone by what shows them, of several targets exactly."""
    if len(targets) == 1 and targets[0].has_all_antennas:
        return score_in_means(model, families, targets[0])
    if len(targets) == 1 and targets[0].scope == "path":
        return score_in_path(model, families, int(np.flatnonzero(targets[0].is_member)[0]))
    return score_families(model, families, targets)


def score_gated(
    model: LinearModel, targets: Sequence[Target], one: ScoredSentence, choices: int = 1
) -> list[ScoredSentence]:
    """The best of a sentence, and of its products with courses that say when it acts."""
    place, law, course = parts_of(one.template)
    together = [course, *gated(model.station.conditions, course)]
    return score_sentences(model, targets, [(place, law)], list(dict.fromkeys(together)), choices)


class Lengths:
    """Description lengths in chi^2: twice the ln of the number of alternatives at each choice, that of a target too.

    Each estimated number beside the size is told to one part in the score: its length is the ln of the gain (Schwarz
    1978, Ann. Statist. 6, 461, with the information on a number in the place of the count of values).
    """

    def __init__(self, conditions: Conditions, targets: int) -> None:
        self._laws = Counter(one[0] for one in list_laws(conditions))
        self._courses = Counter(one[0] for one in list_courses(conditions))
        self._channels = conditions.frequency_mhz.size
        self._targets = targets

    def spectral(self, law: Form, gain: float) -> float:
        """Length of place, law and target of a sentence with a gain in chi^2."""
        alternatives = len(PLACES) * len(LAWS) * max(self._laws[law[0]], 1) * self._targets
        numbers, chosen = (len(law) - 2) * (law[0] == CURVE), 0.0
        if law[0] == CHANNELS:
            numbers, chosen = len(law) // 2 - 1, float(np.log(comb(self._channels, len(law) // 2)))
        return float(2.0 * (np.log(alternatives) + chosen) + numbers * np.log(max(gain, 1.0)))

    def temporal(self, course: Form, gain: float) -> float:
        """Length of a course of `causes.grammar`; a product is as long as both."""
        if course[0] == PRODUCT:
            return self.temporal(course[1], gain) + self.temporal(course[2], gain)
        estimated = (course[0] == SERIES) * (len(course) - 3) * np.log(max(gain, 1.0))
        return float(2.0 * np.log(len(COURSES) * max(self._courses[course[0]], 1)) + estimated)


def _best_by_course(scored: Sequence[ScoredSentence]) -> list[ScoredSentence]:
    """The few likeliest sentences of courses of different names, the likeliest first."""
    best: dict[tuple[str, ...], ScoredSentence] = {}
    for one in sorted(scored, key=lambda one: -one.gain):
        best.setdefault(names_in(parts_of(one.template)[2]), one)
    return list(best.values())[:TRIED]


def best_of_families(scored: Sequence[ScoredSentence]) -> list[ScoredSentence]:
    """The best of each family, the likeliest first."""
    best: dict[tuple[str, ...], ScoredSentence] = {}
    for one in sorted(scored, key=lambda one: -one.gain):
        best.setdefault(one.family, one)
    return list(best.values())


def refine_sentence(model: LinearModel, one: ScoredSentence) -> ScoredSentence:
    """The same with the best numbers of law and course, of which one is moved at a time, and with a positive size."""
    conditions = model.station.conditions
    for share in SHARES_OF_STEP:
        moved = Sentence(share_of_step=share).finer_templates(conditions, one.template)
        one = max(_score_alike(model, one, moved), key=lambda tried: abs(tried.z))
        turned = opposite(one.template) if one.size < 0.0 else None
        if turned is not None:
            (one,) = _score_alike(model, one, [turned])
    return _score_exactly(model, _round_delay(model, one))


def scatter_by_numbers(model: LinearModel, one: ScoredSentence) -> float:
    """Scatter of the size of a sentence over the numbers that the data leave open, as a fraction of the size.

    A number of an error s, whose change by p costs (p / s)^2 in chi^2 and changes the size by b p, adds (b s)^2: the
    square of the change of size over that of chi^2, no more than the largest change tried.
    """
    conditions = model.station.conditions
    moved = [Sentence(share_of_step=share).finer_templates(conditions, one.template) for share in set(SHARES_OF_STEP)]
    there, *others = _score_alike(model, one, [one.template, *chain.from_iterable(moved)])
    changes: dict[tuple[int, ...], list[tuple[float, float]]] = {}
    for other in others:
        pairs = zip(_flat(parts_of(there.template)), _flat(parts_of(other.template)), strict=True)
        which = tuple(k for k, (own, tried) in enumerate(pairs) if own != tried)
        changes.setdefault(which, []).append((there.z**2 - other.z**2, other.size / there.size - 1.0))
    scatter = 0.0
    for which, tried in changes.items():
        if len(which) == 1 or not all((k,) in changes for k in which):  # of two that move together, each by itself
            cost, square = sum(loss for loss, _ in tried), sum(change**2 for _, change in tried)
            most = max(change**2 for _, change in tried)
            scatter += min(square / cost, most) if cost > 0.0 else most
    return float(scatter**0.5)


def _flat(form: Form) -> list[Any]:
    """Names and numbers of a form one after the other."""
    return list(chain.from_iterable(_flat(one) if isinstance(one, tuple) else [one] for one in form))


def _round_delay(model: LinearModel, one: ScoredSentence) -> ScoredSentence:
    """The same with a delay rounded at the first digit of its error, the hours in which its chi^2 rises by 1."""
    place, law, course = parts_of(one.template)
    if course[0] != "late":
        return one
    beside = [sentence(place, law, ("late", course[1] + hours)) for hours in (-1.0, 0.0, 1.0)]
    earlier, there, later = (tried.z**2 for tried in _score_alike(model, one, beside))
    if 2.0 * there <= earlier + later:
        return one
    error = (there - 0.5 * (earlier + later)) ** -0.5
    return replace(one, template=sentence(place, law, ("late", round(course[1], -int(np.floor(np.log10(error)))))))


def _score_exactly(model: LinearModel, one: ScoredSentence) -> ScoredSentence:
    """The same with the score that a cause has, in the means and in the deviations of all paths."""
    known = model.on_events(SENTENCE.known_events(model.station.conditions, one.template))
    families = group_templates(known.station.conditions, SENTENCE, [one.template])
    ((_, z, size),) = score_families(known, families, [one.target])
    return replace(one, z=z.item(), size=size.item())


def _score_alike(model: LinearModel, one: ScoredSentence, templates: Sequence[Template]) -> list[ScoredSentence]:
    """Templates that read the columns of a sentence, for its target and with its length, in their order."""
    known = model.on_events(SENTENCE.known_events(model.station.conditions, one.template))
    found: dict[tuple[object, ...], ScoredSentence] = {}
    for batch, z, size in _scores(known, group_templates(known.station.conditions, SENTENCE, templates), [one.target]):
        for family, *of_family in zip(batch, z[:, 0].tolist(), size[:, 0].tolist(), strict=True):
            for template, own_z, own_size in zip(family.templates, *of_family, strict=True):
                found[parts_of(template)] = replace(one, template=template, z=own_z, size=own_size)
    return [found[parts_of(template)] for template in templates]


def vary_sentence(model: LinearModel, one: ScoredSentence, choices: int) -> list[ScoredSentence]:
    """The same with any other law, at any other place, and with any other course, or another factor of it."""
    place, law, course = parts_of(one.template)
    conditions = model.station.conditions
    spectra = [(place, other) for other in list_laws(conditions)]
    spectra += [(name, law) for name in places_of(one.target, conditions) if PLACES[name].moves == PLACES[place].moves]
    courses = list_courses(conditions)
    factors = course[1:] if course[0] == PRODUCT else (course,)
    every = [*courses, *factors, *(both for own in factors for both in gated(conditions, own))]
    every += [multiply(other, factors[1]) for other in courses] if course[0] == PRODUCT else []
    found = score_sentences(model, [one.target], spectra, [course], choices)
    return found + score_sentences(model, [one.target], [(place, law)], list(dict.fromkeys(every)), choices)


def places_of(target: Target, conditions: Conditions) -> list[str]:
    """Places that the data of a target can tell."""
    is_one = target.scope in ("path", "dipole")
    return [name for name, place in PLACES.items() if place.is_there(conditions) and not (is_one and place.needs_both)]


def multiply(one: Form, other: Form) -> Form:
    """The product of two courses; one of them where it is that."""
    if one == ("always",):
        return other
    return one if names_in(one) == names_in(other) else (PRODUCT, one, other)


def gated(conditions: Conditions, course: Form) -> list[Form]:
    """A course times each of those that say when it acts."""
    gates = [one for one in list_courses(conditions) if COURSES[one[0]].gates or one[0] in OTHER_GATES]
    return [multiply(course, gate) for gate in gates]


def with_one_gate_less(course: Form) -> list[Form]:
    """A product without one of those that say when its first factor acts."""
    if course[0] != PRODUCT:
        return []
    return [course[1], *(multiply(less, course[2]) for less in with_one_gate_less(course[1]))]


def estimate_sentence(model: LinearModel, one: ScoredSentence, choices: int) -> list[ScoredSentence]:
    """The same with a course, with a law, and with a law and then a course whose numbers are estimated all together."""
    length = Lengths(model.station.conditions, choices)
    laws = _estimate(model, one, length, of_law=True)
    return laws + [own for start in (one, *laws) for own in _estimate(model, start, length, of_law=False)]


def _estimate(model: LinearModel, one: ScoredSentence, length: Lengths, *, of_law: bool) -> list[ScoredSentence]:
    """The best number of functions of each kind of law, or of course, in the place of that of a sentence."""
    conditions = model.station.conditions
    place, law, course = parts_of(one.template)
    known = model.on_events(SENTENCE.known_events(conditions, one.template))
    conditions = known.station.conditions
    shown = spectral_signature(SENTENCE, known.terms, conditions, sentence(place, ("flat",), ("always",)))
    in_time = SENTENCE.time_profile(conditions, one.template)
    found = []
    for form, functions, counts in smooth_along_band(conditions) if of_law else smooth_in_time(conditions):
        if of_law:
            templates = [shown * in_time * own for own in functions]
        else:
            templates = [shown * own[:, None] * law_of(conditions, law) for own in functions]
        score, information = known.products(templates, [one.target] * len(templates))
        best: ScoredSentence | None = None
        for count in counts:
            size = invert_symmetric(information[:count, :count], share=1e-6) @ score[:count]
            gain = max(float(size @ score[:count]), 1.0)
            numbers, scale = _in_units(size, functions[:count], is_signed=of_law)
            own = (*form, *numbers)
            new_law, new_course = (own, course) if of_law else (law, own)
            whole = length.spectral(new_law, gain) + length.temporal(new_course, gain)
            whole += 2.0 * float(np.log(len(counts)))
            tried = ScoredSentence(sentence(place, new_law, new_course), one.target, gain**0.5, scale, whole)
            best = tried if best is None or tried.gain > best.gain else best
        found += [] if best is None else [best]
    return found


def move_numbers(model: LinearModel, terms: ChainTerms, one: Hypothesis) -> Hypothesis | None:
    """The same with the numbers of its curve one step of Newton on, in what a fit with it leaves; None without a curve.

    Estimated to first order, the curve of a large effect is that of ln (1 + effect): power of 0.59 of the mean power of
    the sky at one end of the band was 0.63. The scatter of its size is that of the largest value of the curve.

    Parameters
    ----------
    terms
        The chain of that fit, without the effect.
    """
    conditions, (place, law, course) = model.station.conditions, parts_of(one.template)
    of_law = law[0] in (CURVE, CHANNELS)
    if law[0] == CHANNELS:
        functions, numbers = channels_of(conditions, law[1::2]), np.array(law[2::2], dtype=float)
    else:
        kinds = smooth_along_band(conditions) if of_law else smooth_in_time(conditions)
        begin = law[:1] if of_law else course[:2]
        known = next((own for form, own, _ in kinds if form == begin), None)
        if known is None:
            return None
        numbers = np.array((law if of_law else course)[len(begin) :], dtype=float)
        functions = known[: numbers.size]
    at = one.size * numbers / np.abs(numbers @ functions).max()

    def moved(values: Floats) -> Hypothesis:
        own, scale = _in_units(values, functions, is_signed=of_law)
        form = _with_values(law[1::2], own) if law[0] == CHANNELS else (*begin, *own)
        parts = (place, form, course) if of_law else (place, law, form)
        return replace(one, template=sentence(*parts), size=scale)

    def power(values: Floats) -> Floats:
        own = moved(values)
        return SENTENCE.apply(terms, conditions, own.template, own.size).power()

    steps = SENTENCE.step * np.eye(numbers.size)
    pairs = [(power(at + step), power(at - step)) for step in steps]
    templates = [(above - below) / (SENTENCE.step * (above + below)) for above, below in pairs]
    score, information = model.products(templates, [one.target] * numbers.size)
    covariance, largest = invert_symmetric(information, share=1e-6), functions[:, np.argmax(np.abs(at @ functions))]
    open_variance = max(float(largest @ covariance @ largest) - one.sigma**2, 0.0)
    return replace(moved(at + covariance @ score), template_sigma=abs(open_variance**0.5 / one.size))


def _in_units(size: Floats, functions: Floats, *, is_signed: bool) -> tuple[list[float], float]:
    """Numbers of functions relative to the largest value of their sum, in modulus or with its sign, and that value."""
    total = size @ functions
    largest = float(total[np.argmax(np.abs(total))])
    scale = largest if is_signed and largest else max(abs(largest), 1e-300)
    return [float(f"{one:.4g}") for one in size / scale], scale
