"""The test for residual structure, which uses no catalogue: whether structure is left, and along which axis.

Smooth functions of every axis (`lbacal_core.causes.axes`) times smooth functions of frequency are fitted to the means
of a station's paths and to the deviation of every path. Their gain in chi^2 follows the chi^2 distribution where the
residuals are noise. One more test uses no axis: single events.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaincc

from lbacal_core.causes.axes import Axis, list_axes
from lbacal_core.discovery.hypothesis import p_of_best
from lbacal_core.discovery.noise import NoiseLevels, beyond_noise
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FOLDS, held_out_fold
from lbacal_core.discovery.single_events import find_in_events, pattern_of
from lbacal_core.discovery.view import Seen, View
from lbacal_core.grids import Floats
from lbacal_core.linear import fit_least_squares

# What paths show together: each departs too little to be seen alone, but all depart in one way.
#
# A shadow over a field of 48 antennas tilts each path along LST by one or two standard deviations. The scores of all
# paths for smooth functions of an axis, each in units of its noise and less the mean of its class, make a matrix of
# normal numbers, shape (path, function). A common pattern with an amplitude of each path is a matrix of rank one, which
# raises the largest eigenvalue; that of noise has a known law.

SMALLEST = 1e-6
"""Information, relative to the largest, below which a function is a combination of the others."""
SHAPE, SCALE, SHIFT = 46.446, 0.186054, 9.84801
"""Gamma law that is the law of Tracy and Widom to some per cent of a probability (Chiani 2014, J. Multivar. Anal. 129,
69, table 1)."""


def depart(score: Floats, information: Floats) -> tuple[Floats, float]:
    """Scores of the paths of one class less their mean, in units of their noise.

    Paths of one class (a cable name and a polarisation) show the sky and the gains of the station alike: a sky that
    no model has leaves a pattern in the classes, and none in the departures of paths from their class.

    Parameters
    ----------
    score, information
        Shape (path, function) and (path, function, function).

    Returns
    -------
    The same shape as the scores, whitened by the symmetric root, so that paths which are alike keep a pattern alike;
    and how many functions a path tells apart, the mean of all.
    """
    if not len(score):
        return score, 0.0
    roots, told_apart = _roots(information)
    white = np.einsum("pij,pj->pi", roots, score)
    return white - white.mean(axis=0), float(told_apart.mean())


def chance_of_pattern(white: Floats, independent: float, functions: float) -> tuple[float, float, Floats]:
    """Probability by chance of the strongest common pattern in whitened scores, shape (path, function).

    Parameters
    ----------
    independent
        Number of independent rows: departures from a mean lose one.
    functions
        Number of functions that a path tells apart.

    Returns
    -------
    The probability, the chi^2 gained by the pattern, and the amplitude of each path, shape (path,): their squares are
    that chi^2, and their common sign says nothing.
    """
    left, sizes, _ = np.linalg.svd(white, full_matrices=False)
    gain = float(sizes[0] ** 2)
    beyond = beyond_noise(gain, independent, functions)
    return float(gammaincc(SHAPE, max(beyond + SHIFT, 0.0) / SCALE)), gain, left[:, 0] * sizes[0]


def fit_pattern(score: Floats, information: Floats) -> Floats:
    """Sizes of the functions in each path by the strongest common pattern, (path, function).

    With a single path they are those of least squares.
    """
    roots, _ = _roots(information)
    white = np.einsum("pij,pj->pi", roots, score)
    pattern = np.linalg.svd(white, full_matrices=False)[2][0]
    return np.asarray((white @ pattern)[:, None] * (roots @ pattern))


def _roots(information: Floats) -> tuple[Floats, Floats]:
    """Symmetric roots of the inverse on the space that the functions span, and its dimension, of each path."""
    values, vectors = np.linalg.eigh(information)
    is_own = values > SMALLEST * np.maximum(values[:, -1:], 1e-300)
    inverse = np.where(is_own, values, np.inf) ** -0.5
    return vectors * inverse[:, None, :] @ np.swapaxes(vectors, 1, 2), is_own.sum(axis=1).astype(float)


DEGREE, PATH_DEGREE = 5, 3
"""Degree of the Legendre polynomials of frequency: structure of 10 MHz in 50; less for single, noisier paths."""
FEWEST_PATHS = 12
"""Independent departures of paths from which they are asked for what they show together: of fewer the best one shows
almost as much."""
SMALLEST_SIZE = 1e-6
"""Size, relative to the largest, below which a function of an axis is a combination of the others."""
STATION = "station"
"""Target of structure in the means."""
EVENTS = "event"
"""Name of the axis of structure in single events, along none of the axes."""


@dataclass(frozen=True)
class ResidualStructure:
    """Residual structure along one axis: no hypothesis describes it.

    Attributes
    ----------
    axis
        The axis; None where it is in single events.
    target
        ``station``, or the path that shows it most.
    p_value
        After correction for all axes and paths.
    gain, dof
        Chi^2 gained by the empirical term and its number of terms.
    held_out_gain
        Log-likelihood gained on events not used; None in single events, which nothing describes beforehand.
    channel_share
        Share of the structure in each channel, shape (freq,).
    vectors
        Vectors that describe it in the means, shape (vector, polarisation, event, freq); None where a path shows it.
    term
        What they describe, relative change of the power along an axis, shape (polarisation, event, freq), or None.
    coefficients
        Those of the functions in `term`, shape (polarisation, function of frequency, function of the axis), or None.
    amounts
        Amount of the structure in each path, of that in the path which shows most, with its error, where all show it
        together.
    elsewhere
        Axis, as causes call it, of structure that paths show beside that of the means, or the means beside that of
        paths; None where there is none.
    """

    axis: Axis | None
    target: str
    p_value: float
    gain: float
    dof: int
    held_out_gain: float | None
    channel_share: Floats
    vectors: Floats | None
    term: Floats | None = None
    coefficients: Floats | None = None
    amounts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    elsewhere: str | None = None

    @property
    def axis_name(self) -> str:
        """Name in a report."""
        return EVENTS if self.axis is None else self.axis.name

    @property
    def in_words(self) -> str:
        """Its axis in a sentence."""
        return say_axis(self.axis_name)


def say_axis(name: str) -> str:
    """Structure along an axis, by its name in a report, in a sentence."""
    return "structure of single events, along no axis," if name == EVENTS else f"structure along {name}"


def find_structure(
    model: LinearModel, rng: np.random.Generator, alpha: float, again: float | None = None, along: Collection[str] = ()
) -> ResidualStructure | None:
    """Find the most significant residual structure, or None.

    It is reported if its p-value is below `alpha` and its description raises the likelihood of held-out events, else it
    lives elsewhere: events in runs share their LST, so that structure along LST shows along dates.

    Parameters
    ----------
    alpha
        Probability of a false alarm.
    again
        p-value of a cause that is significant a second time for the same target, because its template does not have
        the form of the effect. Structure is then known to remain, and an axis need not be significant by itself: the
        function reports the strongest that raises the likelihood of held-out events, or the strongest of all.
    along
        Axes, as causes call them, along which that cause acts on the station. One of them comes before single events
        and before what chance explains: a band that saturates was told in single events, and in one path.
    """
    found, axes = _try_all(model, rng)
    strongest, found = found[0], _expected_first(found, along, alpha)
    chances = [p_of_best(one.p_value, len(found)) for one in found]
    least = p_of_best(strongest.p_value, len(found))
    for one, chance in zip(found, chances, strict=True):
        if chance >= alpha and (again is None or one.axis is None):
            continue
        told = _tell(model, one, axes, chance if again is None else min(again, least))
        if told.held_out_gain is None or told.held_out_gain > 0:
            return replace(told, elsewhere=_left_apart(one, found, alpha))
    return None if again is None else _tell(model, strongest, axes, min(again, least))


def _left_apart(one: _Candidate, found: Sequence[_Candidate], alpha: float) -> str | None:
    """Axis, as causes call it, of the strongest structure in paths beside that of the means, or the other way round."""
    apart = (other for other in found if (other.target == STATION) != (one.target == STATION))
    left = (other.axis.along for other in apart if other.axis and p_of_best(other.p_value, len(found)) < alpha)
    return next(left, None)


def _expected_first(found: Sequence[_Candidate], along: Collection[str], alpha: float) -> list[_Candidate]:
    """The candidates in their order, but that those of the means along some axes come before all that chance explains.

    They come before single events too, and behind what is less probable by chance than these and than `alpha`.
    """
    events = next(k for k, one in enumerate(found) if one.axis is None)
    before, expected, behind = list[_Candidate](), list[_Candidate](), list[_Candidate]()
    for k, one in enumerate(found):
        if k < events and p_of_best(one.p_value, len(found)) < alpha:
            before.append(one)
        elif one.axis is not None and one.axis.along in along and one.target == STATION:
            expected.append(one)
        else:
            behind.append(one)
    return [*before, *expected, *behind]


def strongest_structure(model: LinearModel, rng: np.random.Generator) -> ResidualStructure:
    """The structure that chance explains least, however well it does."""
    found, axes = _try_all(model, rng)
    return _tell(model, found[0], axes, p_of_best(found[0].p_value, len(found)))


def _try_all(model: LinearModel, rng: np.random.Generator) -> tuple[list[_Candidate], Mapping[Axis, Floats]]:
    """Structure along each axis and in single events, the least probable by chance first; functions of each axis."""
    conditions = model.station.conditions
    axes = {axis: basis for axis in list_axes(conditions) if (basis := axis.basis(conditions)) is not None}
    means, levels = _see_in_means(model), model.residuals.levels
    found = [_in_single_events(model, rng), *(_in_means(levels, means, axis, basis) for axis, basis in axes.items())]
    if len(model.station.antenna) > len(model.paths_in_mean):
        paths = _see_in_paths(model)
        found += [_in_paths(model, paths, axis, basis) for axis, basis in axes.items()]
    return sorted(found, key=lambda one: (one.p_value, -one.deviations)), axes


def _tell(model: LinearModel, one: _Candidate, axes: Mapping[Axis, Floats], chance: float) -> ResidualStructure:
    """What is reported of a candidate that has this probability by chance."""
    held_out, vectors, term, coefficients, amounts = None, None, None, None, dict[str, tuple[float, float]]()
    if one.axis is None:
        vectors, share = pattern_of(model, one.spectrum), one.spectrum**2
    else:
        held_out, share, size, of_places = _describe(one.places, axes[one.axis], held_out_fold(model.station))
        if len(one.places) > 1:
            pairs = zip(one.places, of_places.tolist(), strict=True)
            amounts = {place.label: (amount, sigma) for place, (amount, sigma) in pairs}
        if one.target == STATION:
            vectors = _vectors(one.places[0], axes[one.axis])
            term = np.tensordot(size, vectors, axes=1)
            shown = one.places[0].seen.values[:, :, 0]
            onto = fit_least_squares(_polynomials(shown.shape[2]).T, shown.reshape(-1, shown.shape[2]).T)
            onto = onto.T.reshape(*shown.shape[:2], -1)
            coefficients = np.einsum("krl,kn->rln", onto, size.reshape(len(onto), -1))
    return ResidualStructure(
        one.axis, one.target, chance, one.gain, one.dof, held_out, share, vectors, term, coefficients, amounts
    )


def structure_along(
    model: LinearModel, rng: np.random.Generator, alpha: float, name: str, chance: float
) -> ResidualStructure | None:
    """The structure of the means along an axis, by its name in a report, that has a probability known otherwise.

    None where these data do not have the axis.
    """
    found, axes = _try_all(model, rng)
    for one in found:
        if one.axis is not None and one.target == STATION and name in (one.axis.name, one.axis.column):
            return replace(_tell(model, one, axes, chance), elsewhere=_left_apart(one, found, alpha))
    return None


@dataclass(frozen=True)
class _Shown:
    """Functions of frequency as a view shows them.

    Attributes
    ----------
    by_event
        What each event adds to their scores, shape (k, member, event).
    """

    view: View
    seen: Seen
    by_event: Floats

    @classmethod
    def of(cls, view: View, values: Floats) -> _Shown:
        """Those of functions that are the same in every event, shape (k, row, 1, freq)."""
        seen = view.see(np.broadcast_to(values, (len(values), *view.slope.shape)))
        return cls(view, seen, view.score_by_event(seen))


@dataclass(frozen=True)
class _Place:
    """Where structure is seen: the member of a view, and the functions of frequency there."""

    label: str
    view: View
    member: int
    seen: Seen


@dataclass(frozen=True)
class _Candidate:
    """Chi^2 that smooth functions of an axis gain: in the means, or in the path that shows most.

    Attributes
    ----------
    places
        Where it is seen: one, or all paths where they show it together, the one that shows most first.
    """

    axis: Axis | None
    target: str
    p_value: float
    gain: float
    dof: int
    places: Sequence[_Place] = ()
    spectrum: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def deviations(self) -> float:
        """Gain beyond chance in standard deviations (Wilson & Hilferty 1931), for probabilities that are 0."""
        spread = 2.0 / (9.0 * self.dof)
        return float((np.cbrt(self.gain / self.dof) - 1.0 + spread) / spread**0.5)


def _polynomials(channels: int) -> Floats:
    """Smooth functions of frequency, shape (function, freq)."""
    return np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, channels), DEGREE).T, dtype=float)


def _signs(polarisations: int) -> Floats:
    """The polarisations in their sum and in the difference of the first and each other, shape (sum or one, one)."""
    signs = np.eye(polarisations)[0] - np.eye(polarisations)
    signs[0] = 1.0
    return np.asarray(signs)


def _see_in_means(model: LinearModel) -> _Shown:
    """Functions of frequency in the sum and the differences of the polarisations."""
    rows, _, channels = model.common.slope.shape
    values = np.einsum("sr,lf->slrf", _signs(rows), _polynomials(channels))
    return _Shown.of(model.common, values.reshape(-1, rows, 1, channels))


def _see_in_paths(model: LinearModel) -> list[_Shown]:
    """Functions of frequency in the deviations of the paths of each class."""
    polynomials = _polynomials(model.station.power.shape[2])[: PATH_DEGREE + 1]
    return [_Shown.of(view, polynomials[:, None, None]) for view in model.paths]


def _in_means(levels: NoiseLevels, shown: _Shown, axis: Axis, basis: Floats) -> _Candidate:
    """Structure of the means along an axis."""
    score = np.einsum("kme,ne->mkn", shown.by_event, basis).reshape(-1)
    gain, dof = _gain(score, shown.view.products([shown.seen], [basis])[0])
    chance = levels.chance_of_gain(gain, dof, basis, DEGREE + 1)
    return _Candidate(axis, STATION, chance, gain, dof, [_Place(STATION, shown.view, 0, shown.seen)])


def _in_paths(model: LinearModel, paths: Sequence[_Shown], axis: Axis, basis: Floats) -> _Candidate:
    """Structure along an axis in the path that shows most, or in all together where that is less probable by chance."""
    station, in_mean = model.station, model.residuals.in_mean
    found, departing, white = list[_Candidate](), list[_Place](), list[Floats]()
    independent, told_apart = 0, 0.0
    for c, (shown, members) in enumerate(zip(paths, model.members, strict=True)):
        score = np.einsum("kme,ne->mkn", shown.by_event, basis).reshape(len(members), -1)
        information = shown.view.products([shown.seen], [basis])
        is_own = in_mean[members]
        rows, functions = depart(score[is_own], information[is_own])
        white.append(rows)
        independent, told_apart = independent + max(len(rows) - 1, 0), told_apart + functions * len(rows)
        for m, k in enumerate(members.tolist()):
            others = 1.0 - in_mean[k] / model.paths_in_mean[model.polarisation_of[c]]
            gain, dof = _gain(score[m], others * information[m])
            label = f"antenna {station.antenna[k]} {station.dipole[k]}"
            place = _Place(label, shown.view, m, shown.seen)
            found.append(_Candidate(axis, label, float(chdtrc(dof, gain)), gain, dof, [place]))
            departing += [place] * bool(in_mean[k])
    best = min(found, key=lambda one: (one.p_value, -one.deviations))
    best = replace(best, p_value=p_of_best(best.p_value, len(found)))
    if independent < FEWEST_PATHS:
        return best
    chance, gain, amplitude = chance_of_pattern(np.concatenate(white), independent, told_apart / len(departing))
    if chance < best.p_value:
        places = [departing[k] for k in np.argsort(-np.abs(amplitude), kind="stable")]
        dof = independent + white[0].shape[1] - 1
        best = _Candidate(axis, places[0].label, chance, gain, dof, places)
    return replace(best, p_value=p_of_best(best.p_value, 2))


def _gain(score: Floats, information: Floats) -> tuple[float, int]:
    """Chi^2 gained by vectors and the number of them that are independent."""
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    kept = size > SMALLEST_SIZE * size.max(initial=SMALLEST_SIZE)
    if not np.any(kept):
        return 0.0, 1
    scaled = information[np.ix_(kept, kept)] / np.outer(size[kept], size[kept])
    values, vectors = np.linalg.eigh(scaled)
    is_own = values > SMALLEST_SIZE * values[-1]
    amplitude = (score[kept] / size[kept]) @ vectors[:, is_own]
    return float(np.sum(amplitude**2 / values[is_own])), int(is_own.sum())


def _vectors(place: _Place, basis: Floats) -> Floats:
    """Functions of the axis times functions of frequency, shape (vector, row, event, freq)."""
    values = place.seen.values
    return np.asarray(np.einsum("ne,kref->knref", basis, values).reshape(-1, *values.shape[1:]))


def _describe(places: Sequence[_Place], basis: Floats, fold: NDArray[np.int64]) -> tuple[float, Floats, Floats, Floats]:
    """The empirical term: a pattern of the first place, and its amount in each.

    Returns
    -------
    The gain in log-likelihood on held-out events; of the first place the share in each channel and the sizes of the
    functions; and the amount of that pattern in each place with its error, shape (place, 2).
    """
    by_fold = [_by_fold(place, basis, fold) for place in places]
    information, score = (np.stack(values) for values in zip(*by_fold, strict=True))
    held_out = 0.0
    for k in range(FOLDS):
        size = fit_pattern(score.sum(axis=1) - score[:, k], information.sum(axis=1) - information[:, k])
        held_out += float(np.sum(size * score[:, k]) - 0.5 * np.einsum("pi,pij,pj", size, information[:, k], size))
    whole = information.sum(axis=1)
    size = fit_pattern(score.sum(axis=1), whole)[0]
    view, member = places[0].view, places[0].member
    term = np.tensordot(size, _vectors(places[0], basis), axes=1)
    squares = np.einsum("ref,e->f", view.clean(term, member) ** 2, view.weight[member] > 0)
    known = np.maximum(np.einsum("i,pij,j->p", size, whole, size), 1e-300)
    amounts = np.stack([score.sum(axis=1) @ size / known, known**-0.5], axis=1)
    return held_out, squares / max(float(squares.sum()), 1e-300), size, amounts


def _by_fold(place: _Place, basis: Floats, fold: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Information and score of functions of an axis that the events of each fold hold."""
    information, _, fitted = place.view.inner_by_fold(place.seen, basis, fold, place.member)
    return information, place.view.score_by_fold(place.seen, basis, fold, place.member, fitted)


def _in_single_events(model: LinearModel, rng: np.random.Generator) -> _Candidate:
    """Structure of the means in single events, along no axis."""
    found = find_in_events(model, _polynomials(model.station.power.shape[2]), rng)
    return _Candidate(None, STATION, found.p_value, found.gain, found.dof, spectrum=found.spectrum)
