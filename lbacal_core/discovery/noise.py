"""Noise of a station: residuals split into the mean of the paths and each path's deviation from it, and their levels.

The relative noise of a spectrum is radiometer noise in each channel, and what an event shares along frequency: a gain
behind everything, one in front of N_RCU, a resonance that moves, each in part common to the station. It lies in the
span of at most three vectors, orthonormal along frequency; its covariance there is estimated from the data, for the
means and for single paths. Antennas that see the same sky share a little of the radiometer noise. Mean and deviations
from the mean are then independent, and so are, in each of them, what lies along the vectors and the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.noise import CHANNELS_PER_VECTOR, MOST_VECTORS, orthonormal
from lbacal_core.causes.axes import list_axes
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
NOISIER_SIGMA = 4.0
"""Standard deviations of the estimate beyond which a path gets a noise scale of its own."""


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations of the relative noise.

    Attributes
    ----------
    vectors
        What an event shares along frequency, orthonormal, shape (k, freq).
    path_channel, path_shared
        Deviation of a path from the mean: standard deviation in a channel, and covariance along the vectors beyond
        that, shape (k, k).
    path_scale
        Noise of each path over the typical one, shape (path,).
    common_channel
        Noise in a channel that all paths of a polarisation share, shape (polarisation,).
    common_sum, common_difference
        Covariance along the vectors that they share beyond that: of the sum of all n polarisations over root n, and of
        each of the n - 1 normalised differences, which is (X - Y) over root 2 where there are two.
    """

    vectors: Floats
    path_channel: float
    path_shared: Floats
    path_scale: Floats
    common_channel: Floats
    common_sum: Floats
    common_difference: Floats


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
    structure = _structure(station)
    free_events = max(events - 2 - structure.shape[1], 1)
    mean = _clean(mean, structure)
    vectors = _choose_vectors(mean, seeds[: max(1, channels // CHANNELS_PER_VECTOR)], free_events)
    outside = max(channels - int(np.sum(np.any(vectors != 0, axis=1))), 1)
    used = events / free_events
    along = mean @ vectors.T
    of_mean = np.mean((mean - along @ vectors) ** 2, axis=(1, 2)) * channels / outside * used
    if len(deviation) == polarisations:
        # A single path has no other to be compared with: all noise counts as its own.
        own_channel, shared = max(float(np.sqrt(of_mean.mean())), SMALLEST_LEVEL), np.zeros((len(vectors),) * 2)
        shared = _beyond(np.einsum("rek,rej->kj", along, along) / along[..., 0].size * used, own_channel**2)
    else:
        amount = deviation @ vectors.T
        dof = np.maximum(station.is_present.sum(axis=1) - 2, 1) * _share_of_path(in_mean, polarisation_of) * scale**2
        rest = np.einsum("pef,pef->p", deviation, deviation) - np.einsum("pek,pek->p", amount, amount)
        own_channel = max(float(np.sqrt(np.median((rest / (dof * outside))[in_mean]))), SMALLEST_LEVEL)
        amount = _clean(amount, structure)
        of_path = np.einsum("pek,pej->pkj", amount, amount) / (dof * free_events / max(events - 2, 1))[:, None, None]
        shared = _beyond(np.median(of_path[in_mean], axis=0), own_channel**2)
    common_channel = np.sqrt(np.maximum(of_mean - own_channel**2 * spread.mean(axis=1), 0.0))
    # The variance of the mean beyond the variance of a mean of independent paths.
    own = shared * spread.mean()
    channel = float(np.mean(common_channel**2) + own_channel**2 * spread.mean())
    total = along.sum(axis=0) / polarisations**0.5
    of_sum, of_difference = _beyond(total.T @ total / events * used - own, channel), np.zeros_like(shared)
    if polarisations > 1:
        differences = np.concatenate(along - along.mean(axis=0))
        of_difference = _beyond(differences.T @ differences / (polarisations - 1) / events * used - own, channel)
    return NoiseLevels(vectors, own_channel, shared, scale, common_channel, of_sum, of_difference)


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


def _clean(values: Floats, structure: Floats) -> Floats:
    """Values, shape (..., event, any), less their part along profiles in time."""
    return np.asarray(values - structure @ (structure.T @ values))


def _choose_vectors(mean: Floats, seeds: Floats, free_events: int) -> Floats:
    """The vectors that events share: the seeds, or where the means have one more, the strongest of all, orthonormal.

    A vector of the means' own must be in most events. What stands out in a few is no noise.
    """
    known = orthonormal(seeds)[:MOST_VECTORS]
    rest = mean - mean @ known.T @ known
    level = np.sqrt(np.maximum(np.mean(rest**2, axis=(1, 2)), SMALLEST_LEVEL**2))
    pooled = np.sum(rest / level[:, None, None], axis=0) / len(mean) ** 0.5
    events, channels = pooled.shape
    values, turned = np.linalg.eigh(pooled.T @ pooled / events)
    largest_of_noise = (1.0 + (channels / free_events) ** 0.5) ** 2 * channels / max(channels - len(known), 1)
    amount = pooled @ turned[:, -1]
    of_most = float(np.quantile(np.abs(amount), ONE_SIGMA)) ** 2
    if values[-1] < STANDS_OUT * largest_of_noise or of_most - 1.0 < IN_MOST * (values[-1] - 1.0):
        return known
    basis = np.concatenate([known, turned[:, -1:].T])
    along = np.sum(mean / level[:, None, None], axis=0) / len(mean) ** 0.5 @ basis.T
    values, turned = np.linalg.eigh(along.T @ along / events)
    return np.asarray(turned[:, -len(known) :].T @ basis)


def _beyond(covariance: Floats, noise: float) -> Floats:
    """The covariance along the vectors beyond independent noise, without negative variances, shape (k, k)."""
    values, turned = np.linalg.eigh((covariance + covariance.T) / 2 - noise * np.eye(len(covariance)))
    return np.asarray((turned * np.maximum(values, 0.0)) @ turned.T)
