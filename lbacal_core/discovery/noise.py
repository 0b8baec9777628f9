"""Noise of a station: residuals split into the mean of the paths and each path's deviation from it.

Mean and deviations are independent, and so are, in each of them, what lies along the vectors that the noise of an event
shares (`levels`) and the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.discovery.levels import SMALLEST_LEVEL, Membership, NoiseLevels, estimate_levels
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

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
    in_mean = _is_complete(is_present, polarisation_of)
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
