"""Noise of a station: residuals split into the mean of the paths and each path's deviation from it.

Mean and deviations are independent, and so are, in each of them, what lies along the vectors that the noise of an event
shares and the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.special import bdtrc, chdtr, chdtrc, chdtri, fdtrc

from lbacal_core.calibration.lines import CHANNELS_PER_VECTOR, MOST_VECTORS, orthonormal
from lbacal_core.causes.cause import RAIN
from lbacal_core.discovery.neighbours import FEWEST_PAIRS, Neighbours
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.linear import fit_least_squares, invert_symmetric, solve_symmetric

# Kinds of events, whose noise has its own covariance: those in rain, where a wet antenna's resonance may move more.

FEWEST_OF_KIND = 40
"""Events of a kind from which its covariance is estimated, to 22 %."""
RARE, BEYOND_CHANCE = 0.1, 1e-3
"""Quantile of the other events that fewer events of a kind must exceed to have a covariance of their own, and the
probability below which so many do not by chance."""
WAYS = ("flag", "linear", "saturating")
"""Ways in which causes follow rain."""
HEAVY, TYLER_ROUNDS = 1e-3, 10
"""Share of normal events beyond which an event counts as no noise; rounds of a fixed point that needs six."""
SMALLEST_DISTANCE = 1e-18
"""Floor of a squared distance: exact data keep a finite weight."""


@dataclass(frozen=True)
class Kinds:
    """Kinds of the events of a station.

    Attributes
    ----------
    of_event
        1 in rain, where these are a kind, else 0, shape (event,).
    follows
        What follows rain as causes know it, shape (event, way), 0 where the events are of one kind.
    is_ordinary
        Events of the second kind without bursts, shape (event,).
    """

    of_event: NDArray[np.int64]
    follows: Floats
    is_ordinary: NDArray[np.bool_]

    @property
    def members(self) -> list[NDArray[np.int64]]:
        """Numbers of the events of each kind, shape (event of the kind,)."""
        return [np.flatnonzero(self.of_event == kind) for kind in range(int(self.of_event.max()) + 1)]

    def beside_rain(self, amount: Floats) -> Floats:
        """Amounts, shape (..., event, k), less what follows rain within its kind, scaled so that noise keeps its size.

        It is structure, and would count as noise of this kind: a resonance that moves with the millimetres of rain
        kept half of its score.
        """
        own, count = self.is_ordinary, int(self.is_ordinary.sum())
        if count <= len(WAYS):
            return amount
        left = amount - self.follows @ fit_least_squares(self.follows[own], amount[..., own, :])
        whole = (count / (count - np.linalg.matrix_rank(self.follows[own]))) ** 0.5
        return np.asarray(np.where(self.of_event[:, None] > 0, whole * left, amount))


def list_kinds(station: Station, amount: Floats) -> Kinds:
    """The kinds of events.

    Events in rain are a kind where they are many, and where fewer scatter more than the dry ones: with the weights of
    these, 38 events in which the resonance moved were called interference and a resonance that widens.

    Parameters
    ----------
    amount
        Amounts of what events may share along frequency, in the means, shape (event, k).
    """
    conditions = station.conditions
    rain = conditions.covariate(RAIN)
    is_wet = np.zeros(len(amount), dtype=bool) if rain is None else np.nan_to_num(rain) > 0
    wet, dry = is_wet & station.is_used, ~is_wet & station.is_used
    one = Kinds(np.zeros(is_wet.size, dtype=np.int64), np.zeros((is_wet.size, len(WAYS))), np.zeros_like(wet))
    if dry.sum() < FEWEST_OF_KIND or wet.sum() <= len(WAYS):
        return one
    both = Kinds(is_wet.astype(np.int64), np.concatenate([conditions.wetness(way) for way in WAYS], axis=1), wet)
    ordinary = wet.copy()
    ordinary[wet] = ~is_heavy(both.beside_rain(amount)[wet])
    both = Kinds(both.of_event, both.follows, ordinary)
    if wet.sum() < FEWEST_OF_KIND:
        inverse = invert_symmetric(amount[dry].T @ amount[dry])
        left = both.beside_rain(amount)
        distance = np.einsum("ek,kj,ej->e", left, inverse, left)
        many = int(np.sum(distance[wet] > np.quantile(distance[dry], 1.0 - RARE)))
        if bdtrc(many - 1, wet.sum(), RARE) >= BEYOND_CHANCE:
            return one
    return both


def is_heavy(amount: Floats) -> NDArray[np.bool_]:
    """Which events are beyond the quantile `HEAVY` of the normal distribution that most show, (event, k) -> (event,).

    Its form is that of the directions of the amounts (Tyler 1987, Ann. Stat. 15, 234), its size that of their median.
    """
    size = amount.shape[1]
    distance, form = np.ones(len(amount)), np.eye(size)
    for _ in range(TYLER_ROUNDS):
        form = amount.T @ (amount / distance[:, None])
        form *= size / max(float(np.trace(form)), SMALLEST_DISTANCE**0.5)
        inverse = invert_symmetric(form)
        distance = np.maximum(np.einsum("ek,kj,ej->e", amount, inverse, amount), SMALLEST_DISTANCE)
    return np.asarray(distance > np.median(distance) * chdtri(size, HEAVY) / chdtri(size, 0.5))


# Noise levels of a station: what an event shares along frequency, and the noise of each channel.
#
# The relative noise of a spectrum is radiometer noise in each channel, and what an event shares along frequency: a gain
# behind everything, one in front of N_RCU, a resonance that moves, each in part common to the station. It lies in the
# span of at most three vectors, orthonormal along frequency; its covariance there is estimated from the data, for the
# means and for the paths of each class. Antennas that see the same sky share a little of the radiometer noise.

SMALLEST_LEVEL = 1e-9
"""Floor of a relative noise level: exact data keep a finite weight."""
STANDS_OUT = 3.3
"""Units of the law of Tracy and Widom beyond which the means have a vector of their own: 1 in 1000 of noise."""
LINE = 5.0
"""Standard deviations at which a channel of an event is cut: beyond are lines of interference, which noise has not."""
ONE_SIGMA, IN_MOST = 0.683, 0.15
"""Quantile of a normal amount at one standard deviation, and the part of an excess variance that most events show."""
FindStep = Callable[[Floats, Floats], tuple[float, Floats]]
"""Finds the step in amounts beside those before, as `Station.find_step`."""
IS_STEP, MOST_STEPS = 38.0, 4
"""Chi^2 of the five numbers of a step that chance exceeds in 4 of 10^7, and the steps that are taken out: two are those
of hours."""
TYPICAL_EVENTS = 100
"""Spectra for which the typical covariance of a path counts in that of a cable name: 14 % of a variance."""
WITHIN_S = 0.5 * 86400.0, 3 * 86400.0, 12 * 86400.0
"""Time between neighbours, whose gains may be alike for hours or days; beyond, only a slow effect makes them so."""
LARGEST, HAS_MEMORY = 3.0, 3.0
"""Standard deviations at which an amount is cut, and those beyond which gains that are alike have memory."""
MEDIAN = np.pi / 2.0
"""Variance of a median over that of a mean."""
GAINS_PRIOR = 1e-4
"""Where nothing is added behind, gains in front and behind are one."""


@dataclass(frozen=True)
class Membership:
    """What the means are made of.

    Attributes
    ----------
    polarisation_of
        Index of the polarisation of each path, shape (path,).
    in_mean
        Whether a path takes part in the mean, shape (path,).
    scale
        Noise of each path over the typical one, shape (path,).
    spread
        Variance of the mean over that of one path, as far as paths are independent, shape (polarisation, event).
    seeds
        Vectors along frequency that an event may share, as each class shows them, shape (class, seed, freq).
    """

    polarisation_of: NDArray[np.int64]
    in_mean: NDArray[np.bool_]
    scale: Floats
    spread: Floats
    seeds: Floats

    @property
    def share_of_path(self) -> Floats:
        """Variance of a path's deviation from the mean over that of the path, shape (path,)."""
        together = np.bincount(self.polarisation_of, weights=self.in_mean)[self.polarisation_of]
        return np.maximum(np.where(self.in_mean, 1.0 - 1.0 / together, 1.0 + 1.0 / together), 1e-3)

    def share_of_class(self, station: Station, polarisation: int | None = None) -> Floats:
        """Share of each class in the paths of the means, of all or of one polarisation, shape (class,)."""
        is_there = self.in_mean if polarisation is None else self.in_mean & (self.polarisation_of == polarisation)
        counts = np.bincount(station.class_of, weights=is_there, minlength=len(self.seeds))
        return np.asarray(counts / counts.sum())


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations of the relative noise.

    Attributes
    ----------
    vectors
        What an event shares along frequency, orthonormal, shape (k, freq).
    kind_of
        Kind of each event, whose noise has its own covariance along the vectors: 1 in rain, else 0, shape (event,).
    path_channel, path_shared
        Deviation of a path from the mean: standard deviation in a channel, and covariance along the vectors beyond
        that for the paths of each class, shape (kind, class, k, k): a gain in front of N_RCU shows more of itself
        behind a short cable.
    class_share
        Share of each class in the paths of the means, shape (class,).
    path_scale
        Noise of each path over the typical one, shape (path,).
    common_channel
        Noise in a channel that all paths of a polarisation share, shape (polarisation,).
    common_sum, common_difference
        Covariance along the vectors that they share beyond that: of the sum of all n polarisations over root n, and of
        each of the n - 1 normalised differences, which is (X - Y) over root 2 where there are two; shape (kind, k, k).
    path_memory, sum_memory, difference_memory
        What neighbouring events add to the covariance of each (`find_memory_of_gains`), shape (k, k).
    """

    vectors: Floats
    kind_of: NDArray[np.int64]
    path_channel: float
    path_shared: Floats
    class_share: Floats
    path_scale: Floats
    common_channel: Floats
    common_sum: Floats
    common_difference: Floats
    path_memory: Floats
    sum_memory: Floats
    difference_memory: Floats

    @property
    def mean_path_shared(self) -> Floats:
        """Covariance along the vectors of the mean path, shape (kind, k, k)."""
        return np.asarray(np.einsum("c,sckj->skj", self.class_share, self.path_shared))

    @property
    def of_channels(self) -> NoiseLevels:
        """The same without what an event shares along frequency."""
        shared = "path_shared", "common_sum", "common_difference", "path_memory", "sum_memory", "difference_memory"
        return replace(self, **{name: np.zeros_like(getattr(self, name)) for name in shared})

    def of_all(self, covariance: Floats) -> Floats:
        """Mean of the covariances of the kinds over all events, (kind, k, k) -> (k, k)."""
        return np.asarray(np.tensordot(np.bincount(self.kind_of) / self.kind_of.size, covariance, axes=1))

    def chance_of_gain(self, gain: float, dof: int, profiles: Floats, functions: int) -> float:
        """Probability by chance of what profiles in time, times functions of frequency, gain in chi^2 of the means.

        Profiles that act in one kind of events alone are compared with the noise of these few events. What they gain
        along its vectors has the law of Hotelling (1931, Ann. Math. Stat. 2, 360), the rest that of chi^2; that of F
        describes both together to a third of the probability. With 64 events in rain, 10^-4 counted as 2 10^-5.

        Parameters
        ----------
        profiles
            Shape (profile, event).
        functions
            Number of functions of frequency.
        """
        acts_in = np.isin(self.kind_of, self.kind_of[np.any(profiles != 0, axis=0)])
        if np.all(acts_in):
            return float(chdtrc(dof, gain))
        along = min(int(np.any(self.vectors != 0, axis=1).sum()), MOST_VECTORS, functions)
        return float(fdtrc(dof, int(acts_in.sum()) * functions / along, gain / dof))


def estimate_levels(
    station: Station, mean: Floats, deviation: Floats, members: Membership, *, takes_slow: bool
) -> tuple[NoiseLevels, Floats]:
    """Estimate the levels, and what the gains that all paths share leave in the deviations.

    Paths differ in the share of the sky in their power, and a gain in front of N_RCU that all have does not cancel in
    their deviations. What the mean of an event tells of it is taken out, or paths on a cable name would move together.

    Parameters
    ----------
    mean
        Shape (polarisation, event, freq).
    deviation
        Each path less the mean of its polarisation, shape (path, event, freq); 0 where absent.
    takes_slow
        Whether what is taken out may follow an axis of the data. It may where an effect on the whole station is scored
        in the means alone; elsewhere it would take a part of the effect.

    Returns
    -------
    The levels, and what is left in the deviations of each class, shape (class, event, freq).
    """
    polarisations, events, channels = mean.shape
    class_share = members.share_of_class(station)
    seeds = members.seeds[:, : max(1, channels // CHANNELS_PER_VECTOR)]
    seen = np.tensordot(class_share, seeds, axes=1)
    is_ordinary = _is_ordinary(mean, seen)
    free_events = max(events - 2 - station.profiles_of_axes.shape[1], 1)
    whole, clean = mean, station.without_axes(mean, is_ordinary)
    kinds = list_kinds(station, clean.sum(axis=0) @ orthonormal(seen)[:MOST_VECTORS].T)
    mean = kinds.beside_rain(clean)
    vectors, mean = _choose_vectors(mean, seen, kinds.members, free_events / events, station.find_step)
    outside = max(channels - int(np.sum(np.any(vectors != 0, axis=1))), 1)
    used = events / free_events
    along = mean @ vectors.T
    path_memory = np.zeros((len(vectors), len(vectors)))
    of_mean = np.mean((mean - along @ vectors) ** 2, axis=(1, 2)) * channels / outside * used
    if len(deviation) == polarisations:
        # A single path has no other to be compared with: all noise counts as its own.
        own_channel = max(float(np.sqrt(of_mean.mean())), SMALLEST_LEVEL)
        of_path = np.stack([np.mean([_scatter(one[own]) for one in along], axis=0) * used for own in kinds.members])
        shared = np.stack([_beyond(one, own_channel**2) for one in of_path])[:, None].repeat(len(seeds), axis=1)
    else:
        amount = deviation @ vectors.T
        share = members.share_of_path * members.scale**2
        dof = np.maximum(station.is_present.sum(axis=1) - 2, 1) * share
        rest = np.einsum("pef,pef->p", deviation, deviation) - np.einsum("pek,pek->p", amount, amount)
        own_channel = max(float(np.sqrt(np.median((rest / (dof * outside))[members.in_mean]))), SMALLEST_LEVEL)
        amount = kinds.beside_rain(station.without_axes(amount, is_ordinary))
        shared = _path_levels(station, amount, kinds, members, used, own_channel)
    common_channel = np.sqrt(np.maximum(of_mean - own_channel**2 * members.spread.mean(axis=1), 0.0))
    # The variance of the mean beyond the variance of a mean of independent paths.
    own = np.einsum("c,sckj->skj", class_share, shared) * members.spread.mean()
    channel = float(np.mean(common_channel**2) + own_channel**2 * members.spread.mean())
    total, differences = along.sum(axis=0) / polarisations**0.5, np.zeros_like(along[:1])
    if polarisations > 1:
        differences = np.tensordot(helmert(polarisations), along, axes=1)
    of_sum, of_difference = (
        np.stack(
            [
                _beyond(np.mean([_scatter(one[at]) for one in parts], axis=0) * used - less, channel)
                for at, less in zip(kinds.members, own, strict=True)
            ]
        )
        for parts in (total[None], differences)
    )
    left = np.zeros((len(seeds), events, channels))
    if len(deviation) > polarisations:
        noise = own + channel * np.eye(len(vectors))
        told = (whole if takes_slow else clean).mean(axis=0) @ vectors.T
        gains = np.matmul(told[:, None], solve_symmetric(of_sum + noise, of_sum)[kinds.of_event])[:, 0] @ vectors
        left = _left_in_classes(station, gains, seeds, members)
        rest = (left @ vectors.T)[station.class_of] * np.any(deviation != 0.0, axis=-1)[..., None]
        amount = deviation @ vectors.T - rest
        path_memory = find_memory_of_gains(station, amount[members.in_mean])
        amount = kinds.beside_rain(station.without_axes(amount, is_ordinary))
        shared = _path_levels(station, amount, kinds, members, used, own_channel)
    memory = path_memory, find_memory_of_gains(station, total[None]), find_memory_of_gains(station, differences)
    common = common_channel, of_sum, of_difference
    return NoiseLevels(vectors, kinds.of_event, own_channel, shared, class_share, members.scale, *common, *memory), left


def find_memory_of_gains(station: Station, amount: Floats) -> Floats:
    """Estimate by how much neighbouring events widen the covariance of slow changes, a share of it, shape (k, k).

    Gains that last for hours or a day are alike in neighbours, and a mean over months is less certain than that of
    independent events. What lasts for months is an effect: it is alike in events further apart as well, which is taken
    off. The median over the paths counts, and nothing that chance explains; of a single series hours are known better.

    Parameters
    ----------
    amount
        Amounts of the vectors, shape (path, event, k); 0 where absent.
    """
    paths, count, size = amount.shape
    order = np.argsort(station.conditions.time_unix)
    hours, days, weeks = every = [Neighbours.of(station.conditions.time_unix[order], within) for within in WITHIN_S]
    apart = weeks.pairs - days.pairs
    if not station.conditions.has_dates or min(days.pairs, apart) < FEWEST_PAIRS:
        return np.zeros((size, size))
    events = np.maximum(np.sum(np.any(amount != 0.0, axis=-1), axis=1), 1)[:, None, None]
    values, turned = np.linalg.eigh(np.einsum("pek,pej->pkj", amount, amount) / events)
    root = (turned * np.maximum(values, SMALLEST_LEVEL**2)[:, None] ** -0.5) @ np.swapaxes(turned, 1, 2)
    white = np.clip(np.moveaxis(amount[:, order] @ root, 0, 1), -LARGEST, LARGEST)
    of_hours, of_days, of_weeks = (one.next_to(white.reshape(count, -1)) for one in every)
    found = []
    for one, beside in ((days, of_days), (hours, of_hours)):
        if one.pairs < FEWEST_PAIRS:
            continue
        left = (beside - one.pairs / apart * (of_weeks - of_days)).reshape(white.shape)
        alike = 2.0 * np.median(np.einsum("epk,epj->pkj", white, left) / events, axis=0)
        of_chance = 2.0 * (one.pairs * (1.0 + one.pairs / apart) * min(MEDIAN / paths, 1.0)) ** 0.5 / count
        values, turned = np.linalg.eigh(alike)
        found.append(np.asarray((turned * np.where(values > HAS_MEMORY * of_chance, values, 0.0)) @ turned.T))
    return max(found, key=np.trace)


def with_memory(covariance: Floats, memory: Floats) -> Floats:
    """The covariance of what varies slowly, by that of independent events, shape (..., k, k)."""
    if not np.any(memory):
        return covariance
    values, turned = np.linalg.eigh(covariance)
    root = (turned * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ np.swapaxes(turned, -1, -2)
    return np.asarray(covariance + root @ memory @ root)


def _path_levels(
    station: Station, amount: Floats, kinds: Kinds, members: Membership, used: float, own_channel: float
) -> Floats:
    """Covariance along the vectors of the paths of each class beyond independent noise, shape (kind, class, k, k).

    Paths of a cable name have it alike; where they have few spectra, that of the median of all paths counts as well.

    Parameters
    ----------
    amount
        Amounts of the vectors in the deviations, shape (path, event, k).
    used
        Events over those that are left when profiles in time are taken out.
    """
    share = members.share_of_path * members.scale**2
    present = np.stack([station.is_present[:, own].sum(axis=1) for own in kinds.members])
    square = np.stack([np.einsum("pek,pej->pkj", amount[:, own], amount[:, own]) for own in kinds.members])
    square *= (used / np.maximum(present * share, SMALLEST_LEVEL))[..., None, None]
    typical = np.median(square[:, members.in_mean], axis=1)
    cable_of_class = np.array(station.conditions.cables)
    cable_of = cable_of_class[station.class_of]
    shared = np.empty((len(square), len(cable_of_class), *typical.shape[1:]))
    for cable in np.unique(cable_of_class):
        own = members.in_mean & (cable_of == cable)
        for s in range(len(square)):
            spectra = float(present[s, own].sum())
            of_own = np.median(square[s, own], axis=0) if np.any(own) else typical[s]
            of_cable = (spectra * of_own + TYPICAL_EVENTS * typical[s]) / (spectra + TYPICAL_EVENTS)
            shared[s, cable_of_class == cable] = _beyond(of_cable, own_channel**2)
    return shared


def _left_in_classes(station: Station, gains: Floats, seeds: Floats, members: Membership) -> Floats:
    """What common gains leave in the deviations of each class, shape (class, event, freq).

    Parameters
    ----------
    gains
        Change of the power of the mean path of each event, shape (event, freq).
    """
    left = np.empty((len(seeds), *gains.shape))
    polarisation_of_class = np.unique(station.conditions.dipoles, return_inverse=True)[1]
    for d in np.unique(polarisation_of_class):
        seen = np.tensordot(members.share_of_class(station, int(d)), seeds, axes=1)
        amount = solve_symmetric(seen @ seen.T, seen @ gains.T, prior=GAINS_PRIOR)
        of_polarisation = polarisation_of_class == d
        left[of_polarisation] = np.einsum("ke,ckf->cef", amount, seeds[of_polarisation] - seen)
    return left


def _scatter(amount: Floats) -> Floats:
    """Covariance of amounts of zero mean, (event, k) -> (k, k), without the few events that are far outside it."""
    amount = amount[np.any(amount != 0, axis=1)]
    size = amount.shape[1]
    inside, cut = amount, 1.0
    if len(amount) > FEWEST_OF_KIND:
        # A normal distribution that is cut at the quantile has a smaller variance.
        inside, cut = amount[~is_heavy(amount)], chdtr(size + 2, chdtri(size, HEAVY)) / (1.0 - HEAVY)
    return np.asarray(inside.T @ inside / (max(len(inside), 1) * cut))


def clean_mean(station: Station, mean: Floats, seeds: Floats) -> Floats:
    """The means, shape (polarisation, event, freq), less what follows any axis of the data."""
    return station.without_axes(mean, _is_ordinary(mean, seeds))


def _is_ordinary(mean: Floats, seeds: Floats) -> NDArray[np.bool_]:
    """Which events are not far outside the noise along the seeds, shape (event,)."""
    known = orthonormal(seeds)
    return ~is_heavy(mean.sum(axis=0) @ known[np.any(known != 0, axis=1)].T)


def _choose_vectors(
    mean: Floats, seeds: Floats, kinds: Sequence[NDArray[np.int64]], share_free: float, find_step: FindStep
) -> tuple[Floats, Floats]:
    """The vectors along which events may share noise: the seeds, and one more where a kind of events has it.

    Such a vector must be in most events of the kind: what stands out in a few is no noise. Lines of interference are
    cut: a few in one channel made a vector about it. What begins or ends is none either: channels with interference
    since a date were a vector, which hid them. The noise of a kind lies along the three strongest combinations.

    Returns
    -------
    The vectors, and the means less the steps that would have made one.
    """
    known = orthonormal(seeds)[:MOST_VECTORS]
    first = found = _find_vector(mean, known, kinds, share_free)
    left, steps = mean, np.empty((0, mean.shape[1]))
    for _ in range(MOST_STEPS):
        if found is None:
            break
        gain, step = find_step(found[1], steps)
        if gain < IS_STEP * float(np.var(found[1][found[1] != 0.0])):
            break
        left, steps = left - step.T @ (step @ left), np.concatenate([steps, step])
        found = _find_vector(left, known, kinds, share_free)
    if first is None or found is None:
        return known, left
    return np.concatenate([known, first[0][None]]), mean


def _find_vector(
    mean: Floats, known: Floats, kinds: Sequence[NDArray[np.int64]], share_free: float
) -> tuple[Floats, Floats] | None:
    """The vector beside those known that stands out most, (freq,), with its amount in each event of its kind, (event,).

    None where no vector stands out of the noise. Amounts are in standard deviations, and 0 in events of other kinds.
    """
    rest = mean - mean @ known.T @ known
    outside = max(mean.shape[2] - len(known), 1)
    level = np.sqrt(np.maximum(np.mean(rest**2, axis=(1, 2)), SMALLEST_LEVEL**2) * mean.shape[2] / outside)
    pooled = np.sum(rest / level[:, None, None], axis=0) / len(mean) ** 0.5
    cut = np.clip(pooled, -LINE, LINE)
    cut -= cut @ known.T @ known
    best, chosen = STANDS_OUT, None
    for own in kinds:
        values, turned = np.linalg.eigh(cut[own].T @ cut[own])
        amount = np.zeros(len(pooled))
        amount[own] = pooled[own] @ turned[:, -1]
        of_most = float(np.quantile(np.abs(amount[own]), ONE_SIGMA)) ** 2
        excess = beyond_noise(share_free * float(values[-1]), share_free * own.size, outside)
        if excess > best and of_most - 1.0 > IN_MOST * (float(np.mean(amount[own] ** 2)) - 1.0):
            best, chosen = excess, (turned[:, -1], amount)
    return chosen


def beyond_noise(largest: float, events: float, channels: float) -> float:
    """The largest eigenvalue of x'x of noise x, shape (event, channel), in units of the law of Tracy and Widom.

    Centre and scale are those of Johnstone (2001, Ann. Stat. 29, 295); of noise 1 in 1000 exceeds 3.3.
    """
    one, other = max(events - 1.0, 1.0) ** 0.5, channels**0.5
    return float((largest - (one + other) ** 2) / ((one + other) * (1.0 / one + 1.0 / other) ** (1 / 3)))


def _beyond(covariance: Floats, noise: float) -> Floats:
    """The covariance along the strongest vectors beyond independent noise, without negative variances, shape (k, k)."""
    values, turned = np.linalg.eigh((covariance + covariance.T) / 2 - noise * np.eye(len(covariance)))
    strongest = np.where(np.arange(values.size) >= values.size - MOST_VECTORS, np.maximum(values, 0.0), 0.0)
    return np.asarray((turned * strongest) @ turned.T)


COMPLETE, COMPLETE_IN_PART = 0.8, 0.5
"""Shares of the events of the most complete path, in all and in a part of the time. A path with less is left out of
the mean: an antenna that dies would change what the mean is made of, and look like a step."""
PARTS, FEWEST_IN_PART = 8, 15
"""Parts of the time, fewer where a part would hold fewer events than this."""
NOISIER_SIGMA = 4.0
"""Standard deviations of the estimate beyond which a path gets a noise scale of its own."""


@dataclass(frozen=True)
class Residuals:
    """Residuals and their noise.

    Attributes
    ----------
    polarisations
        Letters of the dipoles that were recorded, shape (polarisation,).
    in_mean
        Whether a path takes part in the mean, shape (path,).
    mean
        Mean over these paths of each polarisation, shape (polarisation, event, freq).
    deviation
        Each path less the mean of its polarisation and less `taken`, shape (path, event, freq); 0 where absent.
    taken
        What the means tell of the deviations: what gains and the sky, common to all paths, leave in those that show
        more or less of them than the mean does, shape (path, event, freq).
    spread
        Variance of the mean over that of one path, as far as paths are independent, shape (polarisation, event).
    seeds
        Vectors along frequency that an event may share, as each class shows them, shape (class, seed, freq).
    levels
        The noise levels.
    """

    polarisations: NDArray[np.str_]
    in_mean: NDArray[np.bool_]
    mean: Floats
    deviation: Floats
    taken: Floats
    spread: Floats
    seeds: Floats
    levels: NoiseLevels


def split_residuals(station: Station, residual: Floats, seeds: Floats) -> Residuals:
    """Split residuals into mean and deviations and estimate the noise levels.

    Parameters
    ----------
    residual
        Relative, shape (path, event, freq); 0 where absent.
    seeds
        Vectors along frequency that an event may share, as each class shows them, shape (class, seed, freq); without
        the first axis the classes are alike.
    """
    is_present = station.is_present
    polarisations, polarisation_of = np.unique(station.dipole, return_inverse=True)
    in_mean = _is_complete(station, polarisation_of)
    mean, deviation = split_values(station, residual, in_mean)
    seeds = np.broadcast_to(seeds, (len(station.conditions.dipoles), *seeds.shape[-2:]))
    alike = Membership(polarisation_of, in_mean, np.ones(len(is_present)), np.ones(mean.shape[:2]), seeds)
    scale = _path_scale(station, deviation, alike) if np.any(np.bincount(polarisation_of) > 1) else alike.scale
    spread = np.empty(mean.shape[:2])
    for d in range(polarisations.size):
        members = np.flatnonzero(in_mean & (polarisation_of == d))
        present = is_present[members].sum(axis=0)
        spread[d] = scale[members] ** 2 @ is_present[members] / np.maximum(present, 1) ** 2
    levels, left = estimate_levels(
        station, mean, deviation, replace(alike, scale=scale, spread=spread), takes_slow=False
    )
    taken = left[station.class_of] * (deviation != 0.0)
    return Residuals(polarisations, in_mean, mean, deviation - taken, taken, spread, seeds, levels)


def mean_of_paths(station: Station, values: Floats) -> Floats:
    """The mean of each polarisation over the paths that take part in it, shape (polarisation, event, freq)."""
    polarisation_of = np.unique(station.dipole, return_inverse=True)[1]
    return split_values(station, values, _is_complete(station, polarisation_of))[0]


def split_values(station: Station, values: Floats, in_mean: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """The mean of each polarisation, shape (polarisation, event, freq), and each path less it, shape (path, ...).

    Parameters
    ----------
    values
        Shape (path, event, freq); 0 where absent.
    in_mean
        Whether a path takes part in the mean, shape (path,).
    """
    is_present = station.is_present
    polarisations, polarisation_of = np.unique(station.dipole, return_inverse=True)
    mean = np.empty((polarisations.size, *values.shape[1:]))
    deviation = np.empty_like(values)
    for d in range(polarisations.size):
        everyone = np.flatnonzero(polarisation_of == d)
        members = np.flatnonzero(in_mean & (polarisation_of == d))
        present = is_present[members].sum(axis=0)
        mean[d] = values[members].sum(axis=0) / np.maximum(present, 1)[:, None]
        # The mean is unknown where none of its paths is present.
        deviation[everyone] = (values[everyone] - mean[d]) * (is_present[everyone] & (present > 0))[:, :, None]
    return mean, deviation


def estimate_again(station: Station, residuals: Residuals, mean: Floats, sky: Floats | None = None) -> Residuals:
    """The same residuals with levels estimated from other means, from which free vectors have been removed.

    Parameters
    ----------
    mean
        The other means, shape (polarisation, event, freq).
    sky
        What the sky that the means show leaves in the deviations, shape (class, event, freq); None for nothing.
    """
    whole = residuals.deviation + residuals.taken
    taken = np.zeros_like(whole) if sky is None else sky[station.class_of] * (whole != 0.0)
    polarisation_of = np.unique(station.dipole, return_inverse=True)[1]
    members = Membership(
        polarisation_of, residuals.in_mean, residuals.levels.path_scale, residuals.spread, residuals.seeds
    )
    levels, left = estimate_levels(station, mean, whole - taken, members, takes_slow=sky is not None)
    taken += left[station.class_of] * (whole != 0.0)
    return replace(residuals, deviation=whole - taken, taken=taken, levels=levels)


def _is_complete(station: Station, polarisation_of: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which paths have most events of their polarisation, in the whole and in every part of the time, shape (path,).

    Those that stand apart have none.
    """
    is_present = station.is_present & ~np.isin(station.antenna, list(station.apart))[:, None]
    events = is_present.shape[1]
    parts = max(1, min(PARTS, events // FEWEST_IN_PART))
    begins = np.arange(parts) * events // parts
    count = np.column_stack([is_present.sum(axis=1), np.add.reduceat(is_present, begins, axis=1, dtype=int)])
    needed = np.array([COMPLETE, *[COMPLETE_IN_PART] * parts])
    is_complete = np.empty(len(count), dtype=bool)
    for d in range(polarisation_of.max() + 1):
        own = count[polarisation_of == d]
        enough = np.all(own >= needed * own.max(axis=0), axis=1)
        is_complete[polarisation_of == d] = enough if np.any(enough) else own[:, 0] == own[:, 0].max()
    return is_complete


def _path_scale(station: Station, deviation: Floats, members: Membership) -> Floats:
    """Noise of each path over the typical one, by its scatter about its band means, shape (path,)."""
    channels = deviation.shape[2]
    # Each channel's line takes two degrees of freedom of a path's events, the mean of n paths a share 1/n.
    dof = np.maximum(station.is_present.sum(axis=1) - 2, 1)
    rest = deviation - deviation.mean(axis=-1)[:, :, None]
    square = np.einsum("pef,pef->p", rest, rest) / (dof * (channels - 1) * members.share_of_path)
    ratio = square / max(np.median(square[members.in_mean]), SMALLEST_LEVEL**2)
    scatter = np.sqrt(2.0 / (dof * (channels - 1)))
    return np.maximum(np.sqrt(np.where(np.abs(ratio - 1.0) > NOISIER_SIGMA * scatter, ratio, 1.0)), SMALLEST_LEVEL)
