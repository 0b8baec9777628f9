"""Noise of a station: residuals split into the mean of the paths and each path's deviation from it, and their levels.

The relative noise of a spectrum is radiometer noise in each channel plus an event gain that is flat in frequency,
part of it common to the station. Antennas that see the same sky share a little of the radiometer noise. Mean and
deviations from the mean are then independent, and so are, in each of them, the band mean and the rest. All levels are
estimated from the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

SMALLEST_LEVEL = 1e-9
"""Floor of a relative noise level: exact data keep a finite weight."""
COMPLETE, COMPLETE_IN_PART = 0.8, 0.5
"""Shares of the events of the most complete path, in all and in a part of the time. A path with less is left out of
the mean: an antenna that dies would change what the mean is made of, and look like a step."""
PARTS, FEWEST_IN_PART = 8, 15
"""Parts of the time, fewer where a part would hold fewer events than this."""
NOISIER_SIGMA = 4.0
"""Standard deviations of the estimate beyond which a path gets a noise scale of its own."""


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations of the relative noise.

    Attributes
    ----------
    path_channel, path_band
        Deviation of a path from the mean: in a channel, and of its band mean.
    path_scale
        Noise of each path over the typical one, shape (path,).
    common_channel
        Noise in a channel that all paths of a polarisation share, shape (polarisation,).
    common_sum, common_difference
        Noise of the band mean that they share: of (X + Y) and of (X - Y), each over root 2.
    """

    path_channel: float
    path_band: float
    path_scale: Floats
    common_channel: Floats
    common_sum: float
    common_difference: float


@dataclass(frozen=True)
class Residuals:
    """Residuals and their noise.

    Attributes
    ----------
    polarisations
        ``X``, ``Y``, or the one of them that was recorded, shape (polarisation,).
    in_mean
        Whether a path takes part in the mean, shape (path,).
    mean
        Mean over these paths of each polarisation, shape (polarisation, event, freq).
    deviation
        Each path less the mean of its polarisation, shape (path, event, freq); 0 where absent.
    spread
        Variance of the mean over that of one path, as far as paths are independent, shape (polarisation, event).
    levels
        The noise levels.
    """

    polarisations: NDArray[np.str_]
    in_mean: NDArray[np.bool_]
    mean: Floats
    deviation: Floats
    spread: Floats
    levels: NoiseLevels


def split_residuals(station: Station, residual: Floats) -> Residuals:
    """Split residuals into mean and deviations and estimate the noise levels.

    Parameters
    ----------
    residual
        Relative, shape (path, event, freq); 0 where absent.
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
    if np.all(np.bincount(polarisation_of) == 1):
        # A single path has no other to be compared with: all noise counts as its own.
        level = mean.mean(axis=-1)
        channel = max(float(np.std(mean - level[..., None])), SMALLEST_LEVEL)
        band, scale = max(float(np.std(level)), SMALLEST_LEVEL), np.ones(polarisation_of.size)
    else:
        channel, band, scale = _path_levels(station, deviation, in_mean, polarisation_of)
    spread = np.empty(mean.shape[:2])
    for d in range(polarisations.size):
        members = np.flatnonzero(in_mean & (polarisation_of == d))
        present = is_present[members].sum(axis=0)
        spread[d] = scale[members] ** 2 @ is_present[members] / np.maximum(present, 1) ** 2
    levels = NoiseLevels(channel, band, scale, *_common_levels(mean, spread, channel, band))
    return Residuals(polarisations, in_mean, mean, deviation, spread, levels)


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


def _path_levels(
    station: Station, deviation: Floats, in_mean: NDArray[np.bool_], polarisation_of: NDArray[np.int64]
) -> tuple[float, float, Floats]:
    """Noise of a typical path, in a channel and of its band mean, and the noise of each path over the typical."""
    channels = deviation.shape[2]
    # Each channel's line takes two degrees of freedom of a path's events, the mean of n paths a share 1/n.
    dof = np.maximum(station.is_present.sum(axis=1) - 2, 1)
    together = np.bincount(polarisation_of, weights=in_mean)[polarisation_of]
    share = np.maximum(np.where(in_mean, 1.0 - 1.0 / together, 1.0 + 1.0 / together), 1e-3)
    band = deviation.mean(axis=-1)
    square = np.sum((deviation - band[:, :, None]) ** 2, axis=(1, 2)) / (dof * (channels - 1) * share)
    band_square = np.sum(band**2, axis=1) / (dof * share)
    typical = np.median(square[in_mean])
    ratio = square / max(typical, SMALLEST_LEVEL**2)
    scatter = np.sqrt(2.0 / (dof * (channels - 1)))
    scale = np.sqrt(np.where(np.abs(ratio - 1.0) > NOISIER_SIGMA * scatter, ratio, 1.0))
    typical_band = np.median((band_square / scale**2)[in_mean])
    return (
        max(float(np.sqrt(typical)), SMALLEST_LEVEL),
        max(float(np.sqrt(typical_band)), SMALLEST_LEVEL),
        np.maximum(scale, SMALLEST_LEVEL),
    )


def _common_levels(mean: Floats, spread: Floats, channel: float, band: float) -> tuple[Floats, float, float]:
    """Noise that the paths share: the variance of the mean beyond the variance of a mean of independent paths."""
    polarisations, events, channels = mean.shape
    used = events / max(events - 2, 1)
    level = mean.mean(axis=-1)
    square = np.mean((mean - level[..., None]) ** 2, axis=(1, 2)) * channels / (channels - 1) * used
    of_channel = np.sqrt(np.maximum(square - channel**2 * spread.mean(axis=1), 0.0))
    if polarisations == 1:
        common = float(np.mean(level**2) * used - band**2 * spread.mean())
        return of_channel, max(common, 0.0) ** 0.5, 0.0
    pair = [
        float(np.mean(part**2) / 2 * used - band**2 * spread.mean())
        for part in (level.sum(axis=0), level[0] - level[1])
    ]
    return of_channel, max(pair[0], 0.0) ** 0.5, max(pair[1], 0.0) ** 0.5
