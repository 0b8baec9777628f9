"""The noise of background spectra: independent in each channel, plus a few vectors that an event shares along nu.

The relative deviation of event i from its model has the covariance

    C_i = k_i diag(sigma_f^2) + sum_k v_k v_k^T,

radiometer noise (k_i: its variance against that of the typical number of blocks) and at most three vectors. A gain that
fluctuates from event to event behind everything is a vector flat in frequency; in front of N_RCU it has the share of
the sky and of N_LNA in the recorded power; a resonance that moves adds d ln G/d nu times that share. Such vectors span
a few dimensions; their covariance in these, and one more vector if it stands out, are estimated from the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats

MOST_VECTORS = 3
"""More would describe effects that are looked for."""
ROUNDS = 3
"""Rounds between the radiometer noise and the basis, which is weighted by it."""
SMALLEST, SMALLEST_SHARE, SMALLEST_OF_TYPICAL = 1e-12, 0.05, 0.1
"""Floors of a variance, of its share outside the basis, and of a channel's variance over the typical channel's."""
SMALLEST_ANGLE = 1e-3
"""Angle of a vector to those before it below which only rounding tells them apart."""
CHANNELS_PER_VECTOR = 8
"""Channels that each vector needs."""
SEEN = 4.0
"""Standard deviations of its estimate beyond which the variance along a vector counts."""
OUTSTANDING = 1.5
"""Factor above the largest eigenvalue of noise (Marchenko & Pastur 1967) beyond which data have a vector of their
own."""


@dataclass(frozen=True)
class NoiseLevels:
    """Levels of the relative noise of paths.

    Attributes
    ----------
    radiometer
        Shape (path, freq), standard deviation at the typical number of blocks.
    vectors
        v_k, shape (path, vector, freq), orthogonal in units of the radiometer noise; 0 where there is none.
    """

    radiometer: Floats
    vectors: Floats

    @property
    def event_gain(self) -> Floats:
        """Standard deviation of what all channels of an event share, rms over frequency, shape (path,)."""
        return np.asarray(np.sqrt(np.sum(self.vectors**2, axis=1).mean(axis=-1)))

    @property
    def of_band(self) -> Floats:
        """Standard deviation of the mean over all channels of an event, shape (path,)."""
        own = np.mean(self.radiometer**2, axis=-1) / self.radiometer.shape[-1]
        return np.asarray(np.sqrt(np.sum(self.vectors.mean(axis=-1) ** 2, axis=1) + own))


def slope_of_gain(frequency_mhz: Floats, antenna_gain: Floats) -> Floats:
    """Derivative of ln G_ant by frequency, shape (freq,), 1/MHz: the form of a resonance that moves."""
    return np.asarray(CubicSpline(frequency_mhz, np.log(antenna_gain))(frequency_mhz, 1))


def estimate_noise_levels(
    residual: Floats, relative_variance: Floats, fitted_per_channel: int, seeds: Floats
) -> NoiseLevels:
    """Estimate the levels from relative residuals of a fit that is linear in each channel.

    Parameters
    ----------
    residual
        Relative residuals, shape (path, event, freq); any finite number where absent.
    relative_variance
        k_i, shape (path, event); infinite where absent.
    fitted_per_channel
        Parameters that the fit spent on each channel.
    seeds
        Vectors that an event may share, shape (path, seed, freq).
    """
    seeds = seeds[:, : max(1, residual.shape[2] // CHANNELS_PER_VECTOR)]
    precision = 1.0 / relative_variance
    events = np.maximum(np.isfinite(relative_variance).sum(axis=1), 1)
    dof = np.maximum(events - fitted_per_channel, 1)
    weighted = residual * precision[:, :, None]
    covariance = np.matmul(weighted.transpose(0, 2, 1), residual) / dof[:, None, None]
    variance = np.maximum(np.einsum("pff->pf", covariance), SMALLEST)
    for number in range(ROUNDS):
        sigma = np.sqrt(variance)
        white = covariance / (sigma[:, :, None] * sigma[:, None, :])
        basis = orthonormal(seeds / sigma[:, None]).transpose(0, 2, 1)
        rest = _beside(white, basis)
        own = _outstanding(rest, events / residual.shape[2], is_sought=number == ROUNDS - 1)
        basis = np.concatenate([basis, own[:, :, None]], axis=2)
        # What lies outside the basis is radiometer noise; the basis has taken its leverage of it.
        left = np.einsum("pff->pf", rest) - own * np.einsum("pfg,pg->pf", rest, own)
        share = 1.0 - np.sum(basis**2, axis=2)
        variance = np.maximum(variance * left / np.maximum(share, SMALLEST_SHARE), SMALLEST)
        variance = np.maximum(variance, SMALLEST_OF_TYPICAL * np.median(variance, axis=1, keepdims=True))
    white = covariance / (sigma[:, :, None] * sigma[:, None, :])
    inside = np.matmul(basis.transpose(0, 2, 1), np.matmul(white, basis)) - np.eye(basis.shape[2])
    values, turned = np.linalg.eigh(inside)
    strongest = slice(None, -MOST_VECTORS - 1, -1)
    size = np.where(values[:, strongest] > SEEN * np.sqrt(2.0 / events)[:, None], values[:, strongest], 0.0)
    vectors = np.matmul(basis, turned[:, :, strongest]).transpose(0, 2, 1) * np.sqrt(size)[:, :, None] * sigma[:, None]
    # An event of more blocks counts more in the covariance than the gain that it shares does.
    shared = np.sum(precision, axis=1) / events
    return NoiseLevels(sigma, vectors / np.sqrt(np.maximum(shared, 1e-300))[:, None, None])


def orthonormal(vectors: Floats) -> Floats:
    """An orthonormal basis of vectors, shape (..., vector, freq); 0 for one that is a combination of those before."""
    turned, corner = np.linalg.qr(np.swapaxes(vectors, -1, -2))
    own = np.abs(np.diagonal(corner, axis1=-2, axis2=-1))
    is_new = own > SMALLEST_ANGLE * np.linalg.norm(vectors, axis=-1)[..., : own.shape[-1]]
    return np.asarray(np.swapaxes(turned, -1, -2) * is_new[..., None])


def _beside(white: Floats, basis: Floats) -> Floats:
    """The part of covariances that lies outside a basis, shape (path, freq, freq)."""
    along = np.matmul(basis.transpose(0, 2, 1), white)
    inside = np.matmul(basis, along)
    both = np.matmul(np.matmul(inside, basis), basis.transpose(0, 2, 1))
    return np.asarray(white - inside - inside.transpose(0, 2, 1) + both)


def _outstanding(rest: Floats, events_per_channel: Floats, *, is_sought: bool) -> Floats:
    """The strongest vector of covariances, shape (path, freq); 0 where noise has as strong a one, or none is sought."""
    if not is_sought:
        return np.zeros(rest.shape[:2])
    values, vectors = np.linalg.eigh(rest)
    largest_of_noise = (1.0 + events_per_channel**-0.5) ** 2
    return np.asarray(vectors[:, :, -1] * (values[:, -1] > OUTSTANDING * largest_of_noise)[:, None])
