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
from scipy.stats import binom, chi2

from lbacal_core.causes.axes import Axis, list_axes
from lbacal_core.causes.cause import signature
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.kinds import is_heavy
from lbacal_core.discovery.memory import find_memory
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FOLDS, held_out_fold
from lbacal_core.discovery.trials import p_of_best
from lbacal_core.discovery.view import Seen, View
from lbacal_core.grids import Floats

DEGREE, PATH_DEGREE = 5, 3
"""Degree of the Legendre polynomials of frequency: structure of 10 MHz in 50; less for single, noisier paths."""
NOISE_DRAWS = 60
"""Draws of noise for the largest singular value: they give its mean to 13 % and its spread to 9 % of the spread."""
TAIL = 0.8
"""Units s of the tail exp(-2/3 s^1.5) in one spread of the simulated largest eigenvalue. The Tracy-Widom distribution
of order 1 (Johnstone 2001, Ann. Stat. 29, 295) has s = 1.27 x - 1.21 at x spreads: 0.8 x is careful beyond x = 2.6."""
LINE = 5.0
"""Standard deviations at which a channel of an event is cut: beyond are lines of interference, which noise has not."""
ORDINARY = 0.01
"""Share of events far outside the noise that is no structure: interference that was left, in drawn worlds 0.7 %."""
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

    @property
    def axis_name(self) -> str:
        """Name in a report."""
        return EVENTS if self.axis is None else self.axis.name


def find_structure(
    model: LinearModel, rng: np.random.Generator, alpha: float, again: float | None = None
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
    """
    found, axes = _try_all(model, rng)
    chances = [p_of_best(one.p_value, len(found)) for one in found]
    for one, chance in zip(found, chances, strict=True):
        if chance >= alpha and (again is None or one.axis is None):
            continue
        told = _tell(model, one, axes, chance if again is None else min(again, chances[0]))
        if told.held_out_gain is None or told.held_out_gain > 0:
            return told
    return None if again is None else _tell(model, found[0], axes, min(again, chances[0]))


def strongest_structure(model: LinearModel, rng: np.random.Generator) -> ResidualStructure:
    """The structure that chance explains least, however well it does."""
    found, axes = _try_all(model, rng)
    return _tell(model, found[0], axes, p_of_best(found[0].p_value, len(found)))


def _try_all(model: LinearModel, rng: np.random.Generator) -> tuple[list[_Candidate], Mapping[Axis, Floats]]:
    """Structure along each axis and in single events, the least probable by chance first; functions of each axis."""
    conditions = model.station.conditions
    axes = {axis: basis for axis in list_axes(conditions) if (basis := axis.basis(conditions)) is not None}
    means = _see_in_means(model)
    found = [_in_single_events(model, rng), *(_in_means(means, axis, basis) for axis, basis in axes.items())]
    if len(model.station.antenna) > len(model.paths_in_mean):
        paths = _see_in_paths(model)
        found += [_in_paths(model, paths, axis, basis) for axis, basis in axes.items()]
    return sorted(found, key=lambda one: (one.p_value, -one.deviations)), axes


def _tell(model: LinearModel, one: _Candidate, axes: Mapping[Axis, Floats], chance: float) -> ResidualStructure:
    """What is reported of a candidate that has this probability by chance."""
    held_out, vectors, term, coefficients = None, None, None, None
    if one.axis is None or one.place is None:
        vectors, share = _pattern_of(model, one.spectrum), one.spectrum**2
    else:
        held_out, share, size = _describe(one.place, axes[one.axis], held_out_fold(model.station))
        if one.target == STATION:
            vectors = _vectors(one.place, axes[one.axis])
            term = np.tensordot(size, vectors, axes=1)
            signs = _signs(len(term))
            coefficients = np.einsum("sr,slk->rlk", signs, size.reshape(len(term), DEGREE + 1, -1))
    return ResidualStructure(
        one.axis, one.target, chance, one.gain, one.dof, held_out, share, vectors, term, coefficients
    )


def chance_along(model: LinearModel, names: Collection[str], target: str) -> float:
    """Probability by chance of the strongest structure along axes, as causes call them, in the means or in paths."""
    conditions = model.station.conditions
    axes = [axis for axis in list_axes(conditions) if axis.along in names]
    known = [(axis, basis) for axis in axes if (basis := axis.basis(conditions)) is not None]
    if not known:
        return 1.0
    if target == STATION:
        means = _see_in_means(model)
        found = [_in_means(means, axis, basis) for axis, basis in known]
    else:
        paths = _see_in_paths(model)
        found = [_in_paths(model, paths, axis, basis) for axis, basis in known]
    return p_of_best(min(one.p_value for one in found), len(found))


def chance_of_following(model: LinearModel, found: Hypothesis, axis: Axis) -> float:
    """Probability by chance that the size of a cause, which is part of the model, follows an axis as much as it does.

    Absorption in some nights of a month leaves more power by day beside its mean over the month. Interference by day
    describes that, but not that it is there in those nights alone.
    """
    conditions = model.station.conditions
    shown, basis = signature(found.cause, model.terms, conditions, found.template), axis.basis(conditions)
    templates = [shown, *(shown * profile[:, None] for profile in ([] if basis is None else basis))]
    gain, dof = _gain(*model.products(templates, [found.target] * len(templates)))
    return float(chi2.sf(gain, dof))


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

    view: View
    member: int
    seen: Seen


@dataclass(frozen=True)
class _Candidate:
    """Chi^2 that smooth functions of an axis gain: in the means, or in the path that shows most."""

    axis: Axis | None
    target: str
    p_value: float
    gain: float
    dof: int
    place: _Place | None = None
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


def _in_means(shown: _Shown, axis: Axis, basis: Floats) -> _Candidate:
    """Structure of the means along an axis."""
    score = np.einsum("kme,ne->mkn", shown.by_event, basis).reshape(-1)
    gain, dof = _gain(score, shown.view.products([shown.seen], [basis])[0])
    place = _Place(shown.view, 0, shown.seen)
    return _Candidate(axis, STATION, float(chi2.sf(gain, dof)), gain, dof, place)


def _in_paths(model: LinearModel, paths: Sequence[_Shown], axis: Axis, basis: Floats) -> _Candidate:
    """The path that shows most structure along an axis, its probability corrected for the number of paths."""
    station, in_mean = model.station, model.residuals.in_mean
    found = []
    for c, (shown, members) in enumerate(zip(paths, model.members, strict=True)):
        score = np.einsum("kme,ne->mkn", shown.by_event, basis).reshape(len(members), -1)
        information = shown.view.products([shown.seen], [basis])
        for m, k in enumerate(members.tolist()):
            others = 1.0 - in_mean[k] / model.paths_in_mean[model.polarisation_of[c]]
            gain, dof = _gain(score[m], others * information[m])
            label = f"antenna {station.antenna[k]} {station.dipole[k]}"
            place = _Place(shown.view, m, shown.seen)
            found.append(_Candidate(axis, label, float(chi2.sf(gain, dof)), gain, dof, place))
    best = min(found, key=lambda one: (one.p_value, -one.deviations))
    return replace(best, p_value=p_of_best(best.p_value, len(station.antenna)))


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


def _describe(place: _Place, basis: Floats, fold: NDArray[np.int64]) -> tuple[float, Floats, Floats]:
    """Gain in log-likelihood of the empirical term on held-out events, its share in each channel, and its sizes."""
    view, member = place.view, place.member
    information, _, fitted = view.inner_by_fold(place.seen, basis, fold, member)
    score = view.score_by_fold(place.seen, basis, fold, member, fitted)
    held_out = 0.0
    for k in range(FOLDS):
        size = _solve(information.sum(axis=0) - information[k], score.sum(axis=0) - score[k])
        held_out += float(size @ score[k] - 0.5 * size @ information[k] @ size)
    size = _solve(information.sum(axis=0), score.sum(axis=0))
    term = np.tensordot(size, _vectors(place, basis), axes=1)
    squares = np.einsum("ref,e->f", view.clean(term, member) ** 2, view.weight[member] > 0)
    return held_out, squares / max(float(squares.sum()), 1e-300), size


def _solve(information: Floats, score: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(information, score, rcond=SMALLEST_SIZE)[0])


def _in_single_events(model: LinearModel, rng: np.random.Generator) -> _Candidate:
    """Structure in single events: in many, in a few, on one side of zero in some, or alike in neighbours (`memory`).

    The largest singular value of the whitened events x channels matrix of the means stands for the first, outside the
    vectors of the noise: a vector that is off by a few per cent makes what lies beside it go with its amounts, which
    was told as structure in 2 of 216 worlds. Where structure lies along the vectors, the number of events far outside
    the noise stands for the second, and the skewness of the others (Mardia 1970, Biometrika 57, 519) for the third:
    noise has no preferred sign.
    """
    white = _whiten(model, model.residuals.mean)
    vectors, kind_of = model.common.vectors, model.residuals.levels.kind_of
    vectors = vectors[np.any(vectors != 0, axis=1)]
    cut = np.clip(white, -LINE, LINE)
    rest, channels = cut - cut @ vectors.T @ vectors, max(white.shape[1] - len(vectors), 1)
    right = np.linalg.svd(cut, full_matrices=False)[2]
    noise = np.array([_largest_of_noise(rng, len(white), channels) for _ in range(NOISE_DRAWS)])
    # Scaled to the total of the noise, so that a wrong noise level does not look like structure.
    of_noise = max(float(np.sum(rest**2)), SMALLEST_SIZE) / (len(rest) * channels)
    observed = np.linalg.svd(rest, compute_uv=False)[0] ** 2 / of_noise
    mean, spread = float(noise.mean()), float(noise.std())
    excess = max((observed - mean) / spread, 0.0)
    in_many = float(min(np.exp(-2.0 / 3.0 * (TAIL * excess) ** 1.5), 1.0))
    amount = white @ vectors.T
    is_far = np.zeros(len(white), dtype=bool)
    for kind in range(kind_of.max() + 1):
        is_far[kind_of == kind] = is_heavy(amount[kind_of == kind])
    in_few = float(binom.sf(is_far.sum() - 1, is_far.size, ORDINARY))
    on_one_side = _chance_of_skewness(amount[~is_far])
    spectrum = right[0] if in_many <= min(in_few, on_one_side) else np.sum(amount**2, axis=1) @ amount @ vectors
    chances = [in_many, in_few, on_one_side]
    if (memory := find_memory(model.station, cut, vectors, _polynomials(white.shape[1]))) is not None:
        spectrum = memory.spectrum if memory.p_value < min(chances) else spectrum
        chances.append(memory.p_value)
    p_value, spectrum = p_of_best(min(chances), len(chances)), spectrum / np.linalg.norm(spectrum)
    return _Candidate(None, STATION, p_value, float(observed - mean), len(white) + channels, spectrum=spectrum)


def _chance_of_skewness(amount: Floats) -> float:
    """Probability by chance of the skewness of amounts, shape (event, k)."""
    events, size = amount.shape
    centred = amount - amount.mean(axis=0)
    skewness = np.sum((centred @ np.linalg.pinv(centred.T @ centred / events) @ centred.T) ** 3) / events**2
    return float(chi2.sf(events * skewness / 6.0, size * (size + 1) * (size + 2) / 6))


def _largest_of_noise(rng: np.random.Generator, events: int, channels: int) -> float:
    noise = rng.standard_normal((events, channels))
    return float(np.linalg.eigvalsh(noise.T @ noise)[-1])


def _pattern_of(model: LinearModel, spectrum: Floats) -> Floats:
    """What every event has along a whitened spectrum, in the means, shape (1, polarisation, event, freq)."""
    pattern = np.outer(_whiten(model, model.residuals.mean) @ spectrum, spectrum)
    vectors, channel = model.common.vectors, model.common.channel
    amount = pattern @ vectors.T
    outside = (pattern - amount @ vectors) / np.sqrt(np.maximum(channel, 1e-300))[..., None]
    inside = np.squeeze(np.linalg.pinv(_root_of_inside(model)) @ amount[..., None], -1) @ vectors
    return np.asarray((outside + inside) * (channel > 0)[..., None])[None]


def share_of_channels(model: LinearModel, values: Floats) -> Floats:
    """Share of each channel in a whitened vector of the means, shape (freq,), the sum is 1."""
    squares = np.sum(_whiten(model, values) ** 2, axis=0)
    return np.asarray(squares / max(float(squares.sum()), 1e-300))


def _whiten(model: LinearModel, values: Floats) -> Floats:
    """A vector of the means without what is free, both polarisations together, in standard deviations."""
    view = model.common
    clean = view.clean(values)
    amount = clean @ view.vectors.T
    outside = (clean - amount @ view.vectors) * np.sqrt(view.channel)[..., None]
    inside = np.squeeze(_root_of_inside(model) @ amount.sum(axis=0)[..., None], -1) @ view.vectors
    return np.asarray((outside.sum(axis=0) + inside) / np.sqrt(len(clean)))


def _root_of_inside(model: LinearModel) -> Floats:
    """Root of the inverse covariance of the sum of both polarisations along the noise's vectors, (event, k, k)."""
    inside = model.common.inside
    values, turned = np.linalg.eigh(inside.sum(axis=(0, 1)) / len(inside))
    return np.asarray((turned * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(turned, 1, 2))
