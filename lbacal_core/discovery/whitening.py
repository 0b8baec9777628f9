"""Whitened residuals of a station: its mean over paths, and each path against that mean.

The relative noise of a spectrum is radiometer noise in each channel plus an event gain that is flat in frequency,
part of it common to the station, and antennas that see the same sky share a little of the radiometer noise. Mean and
deviations from the mean are then independent, and in each of them what is flat in frequency and what is not: their
levels are all taken from the data. In this basis the noise has unit variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.discovery.baseline import StationData
from lbacal_core.grids import Floats

SMALLEST = 1e-9


@dataclass(frozen=True)
class Levels:
    """Standard deviations of the relative noise.

    Attributes
    ----------
    mean_channel
        Of the mean over paths, in a channel, for each dipole letter, shape (dipole,).
    mean_sum, mean_difference
        Of the band mean of the mean over paths: half sum and half difference of the dipole letters, each times sqrt 2.
    path_channel, path_band
        Of a path against the mean: in a channel, and of its band mean.
    path_scale
        Of each path over the typical one, shape (path,).
    """

    mean_channel: Floats
    mean_sum: float
    mean_difference: float
    path_channel: float
    path_band: float
    path_scale: Floats


@dataclass(frozen=True)
class Residuals:
    """Residuals before and after whitening.

    Attributes
    ----------
    mean
        Mean over the paths of each dipole letter, shape (dipole, event, freq).
    deviation
        Each path against the mean of its letter, shape (path, event, freq).
    weight
        Paths present over all, shape (dipole, event).
    presence
        Spectra present over events, shape (path,).
    levels
        The noise levels.
    """

    letters: NDArray[np.str_]
    mean: Floats
    deviation: Floats
    weight: Floats
    presence: Floats
    levels: Levels

    def whiten_mean(self, values: Floats) -> Floats:
        """Whiten station-wide vectors, shape (..., dipole, event, freq) -> (..., n)."""
        dipoles, events, channels = self.mean.shape
        band = values.mean(axis=-1)
        rest = (values - band[..., None]) * (np.sqrt(self.weight) / self.levels.mean_channel[:, None])[:, :, None]
        root = np.sqrt(self.weight.min(axis=0) / 2)
        parts = [band.sum(axis=-2) * root / self.levels.mean_sum]
        if dipoles == 2:
            parts.append((band[..., 0, :] - band[..., 1, :]) * root / self.levels.mean_difference)
        shape = (*values.shape[:-3], dipoles * events * channels)
        return np.concatenate([rest.reshape(shape), *parts], axis=-1)

    def pull_back_mean(self, whitened: Floats) -> Floats:
        """The transpose of `whiten_mean`, shape (..., n) -> (..., dipole, event, freq)."""
        dipoles, events, channels = self.mean.shape
        rest = whitened[..., : self.mean.size].reshape(*whitened.shape[:-1], dipoles, events, channels)
        rest = rest * (np.sqrt(self.weight) / self.levels.mean_channel[:, None])[:, :, None]
        rest = rest - rest.mean(axis=-1, keepdims=True)
        root = np.sqrt(self.weight.min(axis=0) / 2) / channels
        band = whitened[..., self.mean.size :].reshape(*whitened.shape[:-1], dipoles, events)
        common = band[..., 0, :] * root / self.levels.mean_sum
        if dipoles == 1:
            return np.asarray(rest + common[..., None, :, None])
        opposed = band[..., 1, :] * root / self.levels.mean_difference
        return np.asarray(rest + np.stack([common + opposed, common - opposed], axis=-2)[..., None])

    def pull_back_path(self, whitened: Floats) -> Floats:
        """The transpose of `whiten_path`, shape (..., n) -> (..., event, freq)."""
        _, events, channels = self.mean.shape
        rest = whitened[..., : events * channels].reshape(*whitened.shape[:-1], events, channels)
        rest = (rest - rest.mean(axis=-1, keepdims=True)) / self.levels.path_channel
        band = whitened[..., events * channels :] / (self.levels.path_band * channels)
        return np.asarray(rest + band[..., None])

    def gram_mean(self, left: Floats, right: Floats) -> Floats:
        """Inner products of whitened station-wide vectors, from (k, dipole, event, freq) and (l, ...): (k, l)."""
        channels = left.shape[-1]
        a, b = left.mean(axis=-1), right.mean(axis=-1)
        weight = (self.weight / self.levels.mean_channel[:, None] ** 2).astype(left.dtype)
        scaled = left * weight[:, :, None]
        total = scaled.reshape(len(left), -1) @ right.reshape(len(right), -1).T
        total -= channels * ((a * weight).reshape(len(a), -1) @ b.reshape(len(b), -1).T)
        joint = self.weight.min(axis=0) / 2
        total += ((a.sum(axis=1) * joint) @ b.sum(axis=1).T) / self.levels.mean_sum**2
        if left.shape[1] == 2:
            opposed, other = a[:, 0] - a[:, 1], b[:, 0] - b[:, 1]
            total += ((opposed * joint) @ other.T) / self.levels.mean_difference**2
        return np.asarray(total)

    def norm_path(self, values: Floats) -> Floats:
        """Squared norms of whitened vectors of one path, shape (..., event, freq) -> (...)."""
        channels = values.shape[-1]
        band = np.sum(values.mean(axis=-1) ** 2, axis=-1)
        squares = np.einsum("...ef,...ef->...", values, values)
        return np.asarray((squares - channels * band) / self.levels.path_channel**2 + band / self.levels.path_band**2)

    def whiten_path(self, values: Floats) -> Floats:
        """Whiten vectors of one path, shape (..., event, freq) -> (..., n); the path's own scale is left out."""
        band = values.mean(axis=-1)
        rest = (values - band[..., None]) / self.levels.path_channel
        flat = rest.reshape(*values.shape[:-2], values.shape[-2] * values.shape[-1])
        return np.concatenate([flat, band / self.levels.path_band], axis=-1)


def split_residuals(data: StationData, residual: Floats) -> Residuals:
    """Split residuals into mean and deviations and estimate the noise levels.

    Parameters
    ----------
    residual
        Relative, shape (path, event, freq); 0 where absent.
    """
    is_present = data.is_present
    letters = np.unique(data.dipole)
    mean, weight = [], []
    deviation = np.empty_like(residual)
    for letter in letters:
        members = np.flatnonzero(data.dipole == letter)
        count = is_present[members].sum(axis=0)
        average = residual[members].sum(axis=0) / np.maximum(count, 1)[:, None]
        mean.append(average)
        weight.append(count / members.size)
        deviation[members] = (residual[members] - average) * is_present[members][:, :, None]
    presence = is_present.mean(axis=1)
    return Residuals(
        letters, np.stack(mean), deviation, np.stack(weight), presence,
        _estimate_levels(data, np.stack(mean), deviation, np.stack(weight)),
    )  # fmt: skip


def _estimate_levels(data: StationData, mean: Floats, deviation: Floats, weight: Floats) -> Levels:
    _, events, channels = mean.shape
    # Each channel's line takes two degrees of freedom of a path's events, the mean of n paths a share 1/n.
    dof = max(events - 2, 1)
    band = mean.mean(axis=-1)
    rest = (mean - band[..., None]) * np.sqrt(weight)[:, :, None]
    mean_channel = np.sqrt(np.sum(rest**2, axis=(1, 2)) / (dof * (channels - 1)))
    joint = np.sqrt(weight.min(axis=0))
    pair = [band.sum(axis=0), band[0] - band[-1]]
    mean_sum, mean_difference = (float(np.sqrt(np.sum((part * joint) ** 2) / (2 * dof))) for part in pair)
    own_band = deviation.mean(axis=-1)
    path_dof = np.maximum(data.is_present.sum(axis=1) - 2, 1)
    share = 1.0 - 1.0 / np.array([np.sum(data.dipole == letter) for letter in data.dipole])
    share = np.maximum(share, 1e-3)
    square = np.sum((deviation - own_band[:, :, None]) ** 2, axis=(1, 2)) / (path_dof * (channels - 1) * share)
    band_square = np.sum(own_band**2, axis=1) / (path_dof * share)
    path_channel, path_band = np.sqrt(np.median(square)), np.sqrt(np.median(band_square))
    ratio = square / max(path_channel**2, SMALLEST**2)
    # Scatter of the estimate itself is left alone: only a path that is noisier than chance gets a scale of its own.
    scatter = np.sqrt(2.0 / (path_dof * (channels - 1)))
    path_scale = np.sqrt(np.where(np.abs(ratio - 1.0) > 4 * scatter, ratio, 1.0))
    return Levels(
        np.maximum(mean_channel, SMALLEST),
        max(mean_sum, SMALLEST),
        max(mean_difference, SMALLEST),
        max(float(path_channel), SMALLEST),
        max(float(path_band), SMALLEST),
        np.maximum(path_scale, SMALLEST),
    )
