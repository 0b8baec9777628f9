"""Blocks of samples to power spectral densities: window, |FFT|^2, exact normalisation, and the noise that remains.

One-sided density of a block x of n samples with window w:
p_k = 2 |sum_t w_t x_t exp(-2 pi i k t / n)|^2 / (f_s sum_t w_t^2), without the 2 for k = 0 and n/2, ADC^2/MHz with f_s
in MHz. By Parseval sum_k p_k f_s/n is the mean square of the windowed
samples over the mean square of the window, whose expectation is the mean square of the samples.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lbacal_core.grids import Floats

HANN_NEIGHBOUR_CORRELATION = (1.0, 4.0 / 9.0, 1.0 / 36.0)
"""Correlation of the noise power in channels 0, 1 and 2 apart under a Hann window: (2/3)^2 and (1/6)^2, from the
window's transform of 3 channels, -1/4, 1/2, -1/4 (Harris 1978, Proc. IEEE 66, 51)."""

CHUNK_SAMPLES = 1 << 17
"""Samples transformed at a time: a chunk and its transform stay in the processor's cache."""


@lru_cache(maxsize=16)
def hann(length: int) -> NDArray[np.float32]:
    """Periodic Hann window, shape (length,)."""
    window = np.sin(np.pi * np.arange(length) / length) ** 2
    window.setflags(write=False)
    return window.astype(np.float32)


def transform_blocks(blocks: NDArray[np.int16]) -> NDArray[np.complex64]:
    """Fourier transform of windowed blocks, shape (block, n) to (block, n/2 + 1).

    Single precision: 1e-7 of the largest line, when the noise that matters is 1e-4 of it.
    """
    return transform_in_place(blocks.astype(np.float32))


def transform_in_place(blocks: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Fourier transform of blocks that may be overwritten."""
    blocks *= hann(blocks.shape[1])
    return np.asarray(scipy.fft.rfft(blocks, axis=1, overwrite_x=True), dtype=np.complex64)


def power_density(blocks: NDArray[np.int16], sample_rate_hz: float) -> Floats:
    """Mean one-sided power spectral density of blocks, ADC^2/MHz.

    Parameters
    ----------
    blocks
        Shape (block, n), ADC units.

    Returns
    -------
    Shape (n/2 + 1,).
    """
    count, length = blocks.shape
    total = np.zeros(length // 2 + 1)
    step = max(1, CHUNK_SAMPLES // length)
    for start in range(0, count, step):
        total += sum_of_squares(transform_blocks(blocks[start : start + step]))
    return np.asarray(total * density_per_square(length, sample_rate_hz) / count)


def sum_of_squares(transform: NDArray[np.complex64]) -> Floats:
    """Sum over blocks of |F|^2, shape (block, channel) to (channel,)."""
    parts = transform.view(np.float32)
    squares = np.einsum("bp,bp->p", parts, parts)  # real and imaginary parts alternate along the last axis
    return np.asarray(squares[0::2] + squares[1::2], dtype=float)


def density_per_square(length: int, sample_rate_hz: float) -> Floats:
    """Factor from |F|^2 of a windowed block to its one-sided density, 1/MHz, shape (n/2 + 1,)."""
    factor = np.full(length // 2 + 1, 2.0)
    factor[0] = 1.0
    if length % 2 == 0:
        factor[-1] = 1.0
    return np.asarray(factor / (1e-6 * sample_rate_hz * np.sum(hann(length).astype(float) ** 2)))


def channel_frequencies(length: int, sample_rate_hz: float) -> Floats:
    """Centre of every channel of a block of `length` samples, MHz, shape (n/2 + 1,)."""
    return np.asarray(np.arange(length // 2 + 1) * (1e-6 * sample_rate_hz / length), dtype=float)


def line_response(offset: Floats) -> Floats:
    """Share of a steady line's power that a Hann-windowed channel sees at `offset` channels from its centre.

    (2/3) sinc^2(d) / (1 - d^2)^2, which sums to 1 over the channels.
    """
    distance = np.abs(np.asarray(offset, dtype=float))
    is_singular = np.abs(distance - 1.0) < 1e-6
    safe = np.where(is_singular, 0.5, distance)
    return np.asarray(np.where(is_singular, 1.0 / 6.0, (2.0 / 3.0) * (np.sinc(safe) / (1.0 - safe**2)) ** 2))


def bin_weights(channel_mhz: Floats, frequency_mhz: Floats, width_mhz: float) -> Floats:
    """Overlap of every channel with every bin, in channels, shape (bin, channel).

    A channel counts with the fraction of its width that lies inside, so that a bin of 1 MHz always holds 5.12
    channels of 0.195 MHz, centred on the bin: whole channels would sit up to 0.1 MHz off, 0.5 % on a steep band.
    """
    width = channel_mhz[1] - channel_mhz[0]
    low = np.maximum(channel_mhz[None, :] - width / 2, frequency_mhz[:, None] - width_mhz / 2)
    high = np.minimum(channel_mhz[None, :] + width / 2, frequency_mhz[:, None] + width_mhz / 2)
    return np.asarray(np.maximum(high - low, 0.0) / width)


def effective_channels(weights: Floats) -> Floats:
    """Independent channels in a weighted mean of Hann channels, shape (..., channel) to (...).

    (sum u)^2 / sum_jk u_j u_k rho_jk; the radiometer noise of the mean of M blocks is 1/sqrt(M x this).
    """
    variance = HANN_NEIGHBOUR_CORRELATION[0] * np.sum(weights**2, axis=-1)
    for apart in (1, 2):
        overlap = np.sum(weights[..., apart:] * weights[..., :-apart], axis=-1)
        variance = variance + 2 * HANN_NEIGHBOUR_CORRELATION[apart] * overlap
    total = np.sum(weights, axis=-1) ** 2
    return np.asarray(np.divide(total, variance, out=np.zeros_like(total), where=variance > 0))
