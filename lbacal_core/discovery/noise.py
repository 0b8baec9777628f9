"""Noise of a station: residuals split into the mean of the paths and each path's deviation from it, and their levels.

The relative noise of a spectrum is radiometer noise in each channel, and what an event shares along frequency: a gain
behind everything, one in front of N_RCU, a resonance that moves, each in part common to the station. It lies in the
span of at most three vectors, orthonormal along frequency; its covariance there is estimated from the data, for the
means and for single paths. Antennas that see the same sky share a little of the radiometer noise. Mean and deviations
from the mean are then independent, and so are, in each of them, what lies along the vectors and the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.stats import chi2

from lbacal_core.calibration.noise import CHANNELS_PER_VECTOR, MOST_VECTORS, orthonormal
from lbacal_core.causes.axes import list_axes
from lbacal_core.causes.conditions import RAIN
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

SMALLEST_LEVEL = 1e-9
"""Floor of a relative noise level: exact data keep a finite weight."""
COMPLETE, COMPLETE_IN_PART = 0.8, 0.5
"""Shares of the events of the most complete path, in all and in a part of the time. A path with less is left out of
the mean: an antenna that dies would change what the mean is made of, and look like a step."""
PARTS, FEWEST_IN_PART = 8, 15
"""Parts of the time, fewer where a part would hold fewer events than this."""
STANDS_OUT = 1.03
"""Factor above the largest eigenvalue of noise beyond which the means have a vector of their own."""
ONE_SIGMA, IN_MOST = 0.683, 0.5
"""Quantile of a normal amount at one standard deviation, and the part of an excess variance that most events show."""
STRUCTURE_SHARE, SMALLEST_PROFILE = 1 / 3, 1e-6
"""Most profiles in time that are no noise, as a share of the events; and the size of one that others contain."""
FEWEST_OF_KIND = 40
"""Events of a kind from which its covariance is estimated, to 22 %."""
HEAVY, TYLER_ROUNDS = 1e-3, 10
"""Share of normal events beyond which an event counts as no noise; rounds of a fixed point that needs six."""
NOISIER_SIGMA = 4.0
"""Standard deviations of the estimate beyond which a path gets a noise scale of its own."""


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
        that, shape (kind, k, k).
    path_scale
        Noise of each path over the typical one, shape (path,).
    common_channel
        Noise in a channel that all paths of a polarisation share, shape (polarisation,).
    common_sum, common_difference
        Covariance along the vectors that they share beyond that: of the sum of all n polarisations over root n, and of
        each of the n - 1 normalised differences, which is (X - Y) over root 2 where there are two; shape (kind, k, k).
    """

    vectors: Floats
    kind_of: NDArray[np.int64]
    path_channel: float
    path_shared: Floats
    path_scale: Floats
    common_channel: Floats
    common_sum: Floats
    common_difference: Floats

    def of_all(self, covariance: Floats) -> Floats:
        """Mean of the covariances of the kinds over all events, (kind, k, k) -> (k, k)."""
        return np.asarray(np.tensordot(np.bincount(self.kind_of) / self.kind_of.size, covariance, axes=1))


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
        Each path less the mean of its polarisation, shape (path, event, freq); 0 where absent.
    spread
        Variance of the mean over that of one path, as far as paths are independent, shape (polarisation, event).
    seeds
        Vectors along frequency that an event may share, shape (seed, freq).
    levels
        The noise levels.
    """

    polarisations: NDArray[np.str_]
    in_mean: NDArray[np.bool_]
    mean: Floats
    deviation: Floats
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
        Vectors along frequency that an event may share, shape (seed, freq).
    """
    is_present = station.is_present
    polarisations, polarisation_of = np.unique(station.dipole, return_inverse=True)
    in_mean = _is_complete(is_present, polarisation_of)
    mean = np.empty((polarisations.size, *residual.shape[1:]))
    deviation = np.empty_like(residual)
    for d in range(polarisations.size):
        everyone = np.flatnonzero(polarisation_of == d)
        members = np.flatnonzero(in_mean & (polarisation_of == d))
        present = is_present[members].sum(axis=0)
        mean[d] = residual[members].sum(axis=0) / np.maximum(present, 1)[:, None]
        # The mean is unknown where none of its paths is present.
        deviation[everyone] = (residual[everyone] - mean[d]) * (is_present[everyone] & (present > 0))[:, :, None]
    scale = np.ones(len(is_present))
    if np.any(np.bincount(polarisation_of) > 1):
        scale = _path_scale(station, deviation, in_mean, polarisation_of)
    spread = np.empty(mean.shape[:2])
    for d in range(polarisations.size):
        members = np.flatnonzero(in_mean & (polarisation_of == d))
        present = is_present[members].sum(axis=0)
        spread[d] = scale[members] ** 2 @ is_present[members] / np.maximum(present, 1) ** 2
    levels = _estimate_levels(station, mean, deviation, in_mean, polarisation_of, scale, spread, seeds)
    return Residuals(polarisations, in_mean, mean, deviation, spread, seeds, levels)


def estimate_again(station: Station, residuals: Residuals, mean: Floats) -> Residuals:
    """The same residuals with levels estimated from other means, from which free vectors have been removed."""
    polarisation_of = np.unique(station.dipole, return_inverse=True)[1]
    levels = _estimate_levels(
        station,
        mean,
        residuals.deviation,
        residuals.in_mean,
        polarisation_of,
        residuals.levels.path_scale,
        residuals.spread,
        residuals.seeds,
    )
    return replace(residuals, levels=levels)


def _is_complete(is_present: NDArray[np.bool_], polarisation_of: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which paths have most events of their polarisation, in the whole and in every part of the time, shape (path,)."""
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


def _share_of_path(in_mean: NDArray[np.bool_], polarisation_of: NDArray[np.int64]) -> Floats:
    """Variance of a path's deviation from the mean over that of the path, shape (path,)."""
    together = np.bincount(polarisation_of, weights=in_mean)[polarisation_of]
    return np.maximum(np.where(in_mean, 1.0 - 1.0 / together, 1.0 + 1.0 / together), 1e-3)


def _path_scale(
    station: Station, deviation: Floats, in_mean: NDArray[np.bool_], polarisation_of: NDArray[np.int64]
) -> Floats:
    """Noise of each path over the typical one, by its scatter about its band means, shape (path,)."""
    channels = deviation.shape[2]
    # Each channel's line takes two degrees of freedom of a path's events, the mean of n paths a share 1/n.
    dof = np.maximum(station.is_present.sum(axis=1) - 2, 1)
    rest = deviation - deviation.mean(axis=-1)[:, :, None]
    square = np.einsum("pef,pef->p", rest, rest) / (dof * (channels - 1) * _share_of_path(in_mean, polarisation_of))
    ratio = square / max(np.median(square[in_mean]), SMALLEST_LEVEL**2)
    scatter = np.sqrt(2.0 / (dof * (channels - 1)))
    return np.maximum(np.sqrt(np.where(np.abs(ratio - 1.0) > NOISIER_SIGMA * scatter, ratio, 1.0)), SMALLEST_LEVEL)


def _estimate_levels(
    station: Station,
    mean: Floats,
    deviation: Floats,
    in_mean: NDArray[np.bool_],
    polarisation_of: NDArray[np.int64],
    scale: Floats,
    spread: Floats,
    seeds: Floats,
) -> NoiseLevels:
    polarisations, events, channels = mean.shape
    structure, known = _structure(station), orthonormal(seeds)
    is_ordinary = ~is_heavy(mean.sum(axis=0) @ known[np.any(known != 0, axis=1)].T)
    free_events = max(events - 2 - structure.shape[1], 1)
    mean = _clean(mean, structure, is_ordinary)
    kind_of = _kinds(station)
    kinds = [np.flatnonzero(kind_of == kind) for kind in range(kind_of.max() + 1)]
    seeds = seeds[: max(1, channels // CHANNELS_PER_VECTOR)]
    vectors = _choose_vectors(mean, seeds, kinds, free_events / events)
    outside = max(channels - int(np.sum(np.any(vectors != 0, axis=1))), 1)
    used = events / free_events
    along = mean @ vectors.T
    of_mean = np.mean((mean - along @ vectors) ** 2, axis=(1, 2)) * channels / outside * used
    if len(deviation) == polarisations:
        # A single path has no other to be compared with: all noise counts as its own.
        own_channel = max(float(np.sqrt(of_mean.mean())), SMALLEST_LEVEL)
        of_path = np.stack([np.mean([_scatter(one[own]) for one in along], axis=0) * used for own in kinds])
    else:
        amount = deviation @ vectors.T
        share = _share_of_path(in_mean, polarisation_of) * scale**2
        dof = np.maximum(station.is_present.sum(axis=1) - 2, 1) * share
        rest = np.einsum("pef,pef->p", deviation, deviation) - np.einsum("pek,pek->p", amount, amount)
        own_channel = max(float(np.sqrt(np.median((rest / (dof * outside))[in_mean]))), SMALLEST_LEVEL)
        amount = _clean(amount, structure, is_ordinary)
        present = np.stack([station.is_present[:, own].sum(axis=1) for own in kinds])
        square = np.stack([np.einsum("pek,pej->pkj", amount[:, own], amount[:, own]) for own in kinds])
        square *= (used / np.maximum(present * share, SMALLEST_LEVEL))[..., None, None]
        of_path = np.median(square[:, in_mean], axis=1)
    shared = np.stack([_beyond(one, own_channel**2) for one in of_path])
    common_channel = np.sqrt(np.maximum(of_mean - own_channel**2 * spread.mean(axis=1), 0.0))
    # The variance of the mean beyond the variance of a mean of independent paths.
    own = shared * spread.mean()
    channel = float(np.mean(common_channel**2) + own_channel**2 * spread.mean())
    total, differences = along.sum(axis=0) / polarisations**0.5, np.zeros_like(along[:1])
    if polarisations > 1:
        differences = np.tensordot(helmert(polarisations), along, axes=1)
    of_sum, of_difference = (
        np.stack(
            [
                _beyond(np.mean([_scatter(one[at]) for one in parts], axis=0) * used - less, channel)
                for at, less in zip(kinds, own, strict=True)
            ]
        )
        for parts in (total[None], differences)
    )
    return NoiseLevels(vectors, kind_of, own_channel, shared, scale, common_channel, of_sum, of_difference)


def _kinds(station: Station) -> NDArray[np.int64]:
    """Kind of each event, shape (event,): 1 in rain, where the resonance of a wet antenna may move more, else 0."""
    rain = station.conditions.covariate(RAIN)
    is_wet = np.zeros(station.power.shape[1], dtype=bool) if rain is None else np.nan_to_num(rain) > 0
    is_apart = min(np.sum(is_wet & station.is_used), np.sum(~is_wet & station.is_used)) >= FEWEST_OF_KIND
    return is_wet.astype(np.int64) if is_apart else np.zeros(is_wet.size, dtype=np.int64)


def _scatter(amount: Floats) -> Floats:
    """Covariance of amounts of zero mean, (event, k) -> (k, k), without the few events that are far outside it."""
    amount = amount[np.any(amount != 0, axis=1)]
    size = amount.shape[1]
    inside, cut = amount, 1.0
    if len(amount) > FEWEST_OF_KIND:
        # A normal distribution that is cut at the quantile has a smaller variance.
        inside, cut = amount[~is_heavy(amount)], chi2.cdf(chi2.isf(HEAVY, size), size + 2) / (1.0 - HEAVY)
    return np.asarray(inside.T @ inside / (max(len(inside), 1) * cut))


def is_heavy(amount: Floats) -> NDArray[np.bool_]:
    """Which events are beyond the quantile `HEAVY` of the normal distribution that most show, (event, k) -> (event,).

    Its form is that of the directions of the amounts (Tyler 1987, Ann. Stat. 15, 234), its size that of their median.
    """
    size = amount.shape[1]
    distance, form = np.ones(len(amount)), np.eye(size)
    for _ in range(TYLER_ROUNDS):
        form = amount.T @ (amount / distance[:, None])
        form *= size / max(float(np.trace(form)), SMALLEST_LEVEL)
        inverse = np.linalg.pinv(form, hermitian=True)
        distance = np.maximum(np.einsum("ek,kj,ej->e", amount, inverse, amount), SMALLEST_LEVEL**2)
    return np.asarray(distance > np.median(distance) * chi2.isf(HEAVY, size) / chi2.median(size))


def _structure(station: Station) -> Floats:
    """Orthonormal profiles in time of what varies smoothly along any axis of the data, shape (event, profile).

    What follows an axis is structure, which causes may explain, and no noise: noise would swallow it. Axes are taken in
    their order while the profiles are few beside the events.
    """
    conditions = station.conditions
    events = station.power.shape[1]
    profiles: list[Floats] = [np.ones((1, events))]
    for axis in list_axes(conditions):
        basis = axis.basis(conditions)
        if basis is not None and sum(map(len, profiles)) + len(basis) <= STRUCTURE_SHARE * events:
            profiles.append(basis)
    found, sizes, _ = np.linalg.svd(np.concatenate(profiles).T, full_matrices=False)
    return np.asarray(found[:, sizes > SMALLEST_PROFILE * sizes[0]])


def _clean(values: Floats, structure: Floats, is_ordinary: NDArray[np.bool_]) -> Floats:
    """Values, shape (..., event, any), less what follows profiles in time in the ordinary events.

    A burst in one event would otherwise leave a part of itself in all that its profiles join with it.
    """
    return np.asarray(values - structure @ (np.linalg.pinv(structure[is_ordinary]) @ values[..., is_ordinary, :]))


def _choose_vectors(mean: Floats, seeds: Floats, kinds: Sequence[NDArray[np.int64]], share_free: float) -> Floats:
    """The vectors that events share: the seeds, or where a kind of events has one more, the strongest of all.

    Such a vector must be in most events of the kind: what stands out in a few is no noise. Kinds count alike.
    """
    known = orthonormal(seeds)[:MOST_VECTORS]
    rest = mean - mean @ known.T @ known
    level = np.sqrt(np.maximum(np.mean(rest**2, axis=(1, 2)), SMALLEST_LEVEL**2))[:, None, None]
    pooled, whole = (np.sum(one / level, axis=0) / len(mean) ** 0.5 for one in (rest, mean))
    channels, best, chosen = mean.shape[2], 1.0, known
    for own in kinds:
        values, turned = np.linalg.eigh(pooled[own].T @ pooled[own] / own.size)
        free_events = max(own.size * share_free, 1.0)
        largest_of_noise = (1.0 + (channels / free_events) ** 0.5) ** 2 * channels / max(channels - len(known), 1)
        of_most = float(np.quantile(np.abs(pooled[own] @ turned[:, -1]), ONE_SIGMA)) ** 2
        excess = values[-1] / (STANDS_OUT * largest_of_noise)
        if excess > best and of_most - 1.0 > IN_MOST * (values[-1] - 1.0):
            best, basis = excess, np.concatenate([known, turned[:, -1:].T])
            along = np.concatenate([whole[one] @ basis.T / one.size**0.5 for one in kinds])
            chosen = np.linalg.eigh(along.T @ along)[1][:, -len(known) :].T @ basis
    return np.asarray(chosen)


def _beyond(covariance: Floats, noise: float) -> Floats:
    """The covariance along the vectors beyond independent noise, without negative variances, shape (k, k)."""
    values, turned = np.linalg.eigh((covariance + covariance.T) / 2 - noise * np.eye(len(covariance)))
    return np.asarray((turned * np.maximum(values, 0.0)) @ turned.T)
