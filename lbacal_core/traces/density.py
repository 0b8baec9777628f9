"""Blocks of samples to power spectral densities: window, |FFT|^2, exact normalisation, and the noise that remains.

One-sided density of a block x of n samples with window w:
p_k = 2 |sum_t w_t x_t exp(-2 pi i k t / n)|^2 / (f_s sum_t w_t^2), without the 2 for k = 0 and n/2, ADC^2/MHz with f_s
in MHz. By Parseval sum_k p_k f_s/n is the mean square of the windowed
samples over the mean square of the window, whose expectation is the mean square of the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from astropy.stats import mad_std
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import gammainccinv, gammaincinv

from lbacal_core.grids import Floats
from lbacal_core.traces.trace import BLOCK_SAMPLES

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


def transform_in_place(blocks: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Fourier transform of Hann-windowed blocks, shape (block, n), which it overwrites: (block, n/2 + 1).

    Single precision: 1e-7 of the largest line, when the noise that matters is 1e-4 of it.
    """
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
        total += sum_of_squares(transform_in_place(blocks[start : start + step].astype(np.float32)))
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


# Narrow-band interference: found by its excess in a fine spectrum and by its steady phase between antennas.
#
# The search runs on segments of up to 16 consecutive blocks (12.2 kHz channels), finer than the 1024-sample blocks of
# the result: a carrier stands out in proportion to the resolution, so lines are found down to about 0.5 % of the noise
# in 1 MHz, five times less than a search in the blocks themselves could.
#
# 1. Excess: mean power over a local median, tested by itself and in boxes of 2, 4, 8, 16 channels, what one box finds
# being replaced before the next: the idea of SumThreshold (Offringa et al. 2010, MNRAS 405, 155), with thresholds
# from the exact Gamma distribution of averaged noise power. Once for every trace, once for a station's mean.
# 2. Phase stability: noise has a random phase difference between two antennas, a transmitter a constant one
# (Corstanje et al. 2016, A&A 590, A41): |mean over segments of exp(i delta phi)|^2, summed over antenna pairs, against
# the median of its neighbours in frequency, because the sky too is slightly correlated between near antennas.

Flags = NDArray[np.bool_]

FALSE_FLAG_RATE = 1e-6
"""Chance that noise alone flags a fine channel in one test: about one in 50 traces loses 12 kHz for nothing."""

BOXES = (1, 2, 4, 8, 16)
STATION_BOXES = (1, 2, 4)
"""Averaged over a station the noise is so small that wide boxes would flag ripples of a few per cent, such as
reflections in 115 m of cable make every MHz."""

PHASE_BOXES = (1, 4, 16, 64)
"""The wide ones are for interference that is wide and weak: 0.8 MHz of it are as steady in phase as a line."""

COARSE_BOXES = (1, 2)
"""The 1024-sample channels are searched as well: blocks beside a dropped one are in no segment of the fine search."""

BASELINE_WIDTH_MHZ = 0.4
FEWEST_IN_GROUP = 0.25
"""A group with less of it clean than this is interpolated from its neighbours."""

REACH = 40
"""Fine channels on either side of a line in which its leakage is looked at; beyond, it is 1e-11 of the line."""

WIDE_EXCESS = 0.25
WIDE_GROUPS = 9
"""A group of 0.4 MHz that exceeds the median of the 9 around it by a quarter is interference as a whole; the 58 MHz
resonance departs from that median by 3 % at most."""

LARGEST_LEAK = 0.01
"""Channels that receive more than this fraction of their noise from lines are left out; what the others receive is
known to about a tenth from the fine spectrum and is subtracted, which leaves less than 0.1 %."""


@dataclass(frozen=True)
class FineSpectrum:
    """Mean power of a trace at the resolution of the search.

    Attributes
    ----------
    density
        Shape (fine,), ADC^2/MHz.
    segments
        Number of segments averaged.
    factor
        Blocks in a segment: a coarse channel is `factor` fine ones.
    channel_mhz
        Width of a fine channel.
    """

    density: Floats
    segments: int
    factor: int
    channel_mhz: float


def find_lines(spectrum: FineSpectrum) -> tuple[Flags, Floats]:
    """Find the lines of one trace, and its spectrum without them.

    Lines distort the first baseline, so it is drawn again without the channels they reach, and searched again.

    Returns
    -------
    Flagged channels, shape (fine,), and the baseline, ADC^2/MHz, shape (fine,).
    """
    baseline = estimate_baseline(spectrum, np.zeros(spectrum.density.size, dtype=bool))
    ratio = spectrum.density / baseline
    is_line = find_excess(ratio, spectrum.segments, BOXES)
    if np.any(is_line):
        baseline = estimate_baseline(spectrum, _reached_by(is_line, ratio - 1.0))
        is_line = find_excess(spectrum.density / baseline, spectrum.segments, BOXES)
    return is_line, baseline


def _reached_by(is_line: Flags, excess: Floats) -> Flags:
    """Fine channels that get more than `LARGEST_LEAK` of their noise from the lines."""
    lines = np.flatnonzero(is_line)
    response = line_response(np.arange(-REACH, REACH + 1.0))
    share = np.maximum(excess[lines], 0.0)[:, None] * response / response[REACH]
    place = lines[:, None] + np.arange(2 * REACH + 1)
    leak = np.bincount(place.ravel(), weights=share.ravel(), minlength=is_line.size + 2 * REACH)[REACH:-REACH]
    return np.asarray(is_line | (leak > LARGEST_LEAK))


def estimate_baseline(spectrum: FineSpectrum, is_line: Flags) -> Floats:
    """The smooth spectrum under the lines, ADC^2/MHz, shape (fine,).

    Medians over what is not a line in groups of 0.4 MHz, brought to the mean by the ratio of median and mean of the
    Gamma distribution, smoothed over three groups and interpolated, both in the logarithm: power laws stay what they
    are.
    """
    density = spectrum.density
    size = max(3, round(BASELINE_WIDTH_MHZ / spectrum.channel_mhz))
    count = max(density.size // size, 1)
    is_clean = ~is_line[: count * size].reshape(count, -1)
    groups = density[: count * size].reshape(count, -1)
    clean = is_clean.sum(axis=1)
    ordered = np.sort(np.where(is_clean, groups, np.inf), axis=1)
    rows = np.arange(count)
    middle = (ordered[rows, np.maximum(clean - 1, 0) // 2] + ordered[rows, np.minimum(clean // 2, size - 1)]) / 2
    centre = (rows + 0.5) * size - 0.5
    is_known = (clean >= FEWEST_IN_GROUP * size) & (middle > 0)
    if not np.any(is_known):
        return np.full(density.size, max(float(np.median(density)), np.finfo(float).tiny))
    level = np.interp(centre, centre[is_known], np.log(middle[is_known] * _median_to_mean(spectrum.segments)))
    around = median_filter(level, size=WIDE_GROUPS, mode="nearest")
    level = np.where(level - around > np.log1p(WIDE_EXCESS), around, level)
    beyond = (2 * level[0] - level[1], 2 * level[-1] - level[-2]) if count > 1 else (level[0], level[0])
    padded = np.concatenate([beyond[:1], level, beyond[1:]])
    smooth = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4
    return np.asarray(np.exp(np.interp(np.arange(density.size), centre, smooth)))


@lru_cache(maxsize=64)
def _median_to_mean(averages: float) -> float:
    """Mean over median of noise power that was averaged."""
    return averages / float(gammaincinv(averages, 0.5))


def find_excess(ratio: Floats, averages: float, boxes: Sequence[int]) -> Flags:
    """Flag channels whose power over the baseline noise cannot reach.

    Parameters
    ----------
    ratio
        Shape (fine,), power over baseline.
    averages
        Independent spectra averaged in `ratio`.
    boxes
        Widths tested, channels, powers of 2, rising.
    """
    remaining = np.where(np.isfinite(ratio), ratio, 1.0)
    is_flagged = np.zeros(ratio.size, dtype=bool)
    for box in boxes:
        running = remaining
        width = 1
        while width < box:
            running = running[:-width] + running[width:]
            width *= 2
        high = np.flatnonzero(running > box * _threshold(averages, box))
        if high.size:
            is_flagged[(high[:, None] + np.arange(box)).ravel()] = True
            remaining[is_flagged] = 1.0
    return is_flagged


@lru_cache(maxsize=256)
def _threshold(averages: float, box: int) -> float:
    """What the mean of `box` neighbouring Hann channels of noise, each averaged, exceeds at the false-flag rate."""
    apart = np.abs(np.subtract.outer(np.arange(box), np.arange(box)))
    correlation = np.append(HANN_NEIGHBOUR_CORRELATION, 0.0)[np.minimum(apart, 3)]
    shape = averages * float(box**2 / correlation.sum())
    return float(gammainccinv(shape, FALSE_FLAG_RATE)) / shape


def find_station_excess(ratios: Floats, averages: float) -> Flags:
    """Flag channels in which the mean over a station's traces exceeds its noise, shape (trace, fine) to (fine,).

    Ratios are power over baseline, `averages` the independent spectra in each. Traces share the sky, so their noise is
    not quite independent: its level is measured where it exceeds theory.
    """
    mean = np.mean(ratios, axis=0)
    theory = averages * len(ratios)
    spread = float(mad_std(mean))
    return find_excess(mean / np.median(mean), min(theory, 1.0 / spread**2) if spread > 0 else theory, STATION_BOXES)


def find_steady_phases(stability: Floats, pairs: int, channel_mhz: float) -> Flags:
    """Flag channels whose phase differences between antennas are steady.

    Parameters
    ----------
    stability
        Shape (fine,), sum over antenna pairs of segments x |mean exp(i delta phi)|^2: Gamma(pairs) for noise.
    """
    size = max(3, round(5 * BASELINE_WIDTH_MHZ / channel_mhz)) | 1
    coarse = stability[: stability.size // size * size].reshape(-1, size)
    centre = (np.arange(len(coarse)) + 0.5) * size - 0.5
    level = np.interp(np.arange(stability.size), centre, np.median(coarse, axis=1)) / float(gammaincinv(pairs, 0.5))
    return find_excess(stability / (pairs * np.maximum(level, 1.0)), pairs, PHASE_BOXES)


def unit_phases(transform: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """A transform with all amplitudes set to 1 (0 stays 0), same shape."""
    size = transform.real**2
    size += transform.imag**2
    np.maximum(size, np.finfo(np.float32).tiny, out=size)
    np.sqrt(size, out=size)
    return np.asarray(transform * np.reciprocal(size, out=size))


def phase_stability(left: NDArray[np.complex64], right: NDArray[np.complex64]) -> Floats:
    """Segments x |mean exp(i delta phi)|^2 of the `unit_phases` of two antennas, shape (segment, fine) to (fine,)."""
    together = np.sum(left * np.conj(right), axis=0)
    return np.asarray((together.real**2 + together.imag**2) / len(left), dtype=float)


def line_leakage(is_line: Flags, excess: Floats, factor: int, channels: int) -> Floats:
    """Power that the lines put into every 1024-sample channel, relative to the noise there, shape (channel,).

    Parameters
    ----------
    is_line
        Shape (fine,), from the search.
    excess
        Shape (fine,), power over the baseline, minus 1.
    factor
        Fine channels in a coarse one: coarse channel j has its centre at the fine channel j x factor.
    channels
        Number of coarse channels.
    """
    widened = np.convolve(is_line, np.ones(3), mode="same") > 0  # a line shows in three fine channels
    lines = np.flatnonzero(widened)
    if lines.size == 0:
        return np.zeros(channels)
    strength = np.maximum(excess[lines], 0.0) / factor
    offset = np.arange(channels)[:, None] - lines[None, :] / factor
    return np.asarray(line_response(offset) @ strength)


# The samples of a trace gone through: statistics and transform of its blocks, and the finer spectrum of segments.

FACTORS = (16, 8, 4, 2)
FEWEST_SEGMENTS = 12
"""Segments are as long as leaves this many of them: below, a single carrier cannot be told from noise."""


@dataclass(frozen=True)
class BlockStatistics:
    """Statistics of each block, by which blocks are chosen.

    Attributes
    ----------
    highest, lowest
        Shape (block,), ADC units.
    mean, mean_square
        Shape (block,), ADC and ADC^2; the mean is that of the windowed samples.
    """

    highest: NDArray[np.int16]
    lowest: NDArray[np.int16]
    mean: Floats
    mean_square: Floats


def transform_trace(
    samples: NDArray[np.int16], channels: slice = slice(None)
) -> tuple[NDArray[np.complex64], BlockStatistics]:
    """Transform all blocks, a chunk that fits the processor's cache at a time.

    Parameters
    ----------
    samples
        Shape (block, 1024).
    channels
        Channels to keep.

    Returns
    -------
    Shape (block, channel), and the statistics of the blocks.
    """
    count = len(samples)
    highest, lowest = np.empty(count, dtype=np.int16), np.empty(count, dtype=np.int16)
    mean, mean_square = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    transform = np.empty((count, len(range(*channels.indices(BLOCK_SAMPLES // 2 + 1)))), dtype=np.complex64)
    step = CHUNK_SAMPLES // BLOCK_SAMPLES
    for start in range(0, count, step):
        chunk = slice(start, start + step)
        samples[chunk].max(axis=1, out=highest[chunk])
        samples[chunk].min(axis=1, out=lowest[chunk])
        blocks = samples[chunk].astype(np.float32)
        np.einsum("bt,bt->b", blocks, blocks, out=mean_square[chunk])
        whole_band = transform_in_place(blocks)
        mean[chunk] = whole_band[:, 0].real
        transform[chunk] = whole_band[:, channels]
    weight = float(np.sum(hann(BLOCK_SAMPLES), dtype=float))
    return transform, BlockStatistics(
        highest, lowest, mean.astype(float) / weight, mean_square.astype(float) / BLOCK_SAMPLES
    )


def find_segments(position: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of consecutive blocks, as long as leaves enough of them, shape (segment, factor), and their numbers."""
    for factor in FACTORS:
        ids, first, counts = np.unique(position // factor, return_index=True, return_counts=True)
        is_whole = counts == factor
        if np.sum(is_whole) >= FEWEST_SEGMENTS:
            return first[is_whole][:, None] + np.arange(factor), ids[is_whole]
    return np.arange(position.size)[:, None], position


def transform_segments(
    samples: NDArray[np.int16], rows: NDArray[np.int64], channels: slice, sample_rate_hz: float, *, keep: bool
) -> tuple[FineSpectrum, NDArray[np.complex64] | None]:
    """Mean power of segments of consecutive blocks, from the first to the last of some channels.

    Parameters
    ----------
    samples
        Shape (block, 1024).
    rows
        Shape (segment, factor): the blocks of every segment.
    channels
        The band, in channels of a block.
    keep
        Whether to return the phases as well.

    Returns
    -------
    The spectrum, and the phases as numbers of size 1, shape (segment, fine), or None.
    """
    segments, factor = rows.shape
    length = factor * BLOCK_SAMPLES
    band = slice(channels.start * factor, (channels.stop - 1) * factor + 1)
    total = np.zeros(band.stop - band.start)
    kept = []
    step = max(1, CHUNK_SAMPLES // length)
    for start in range(0, segments, step):
        of_chunk = rows[start : start + step]
        first, last = of_chunk[0, 0], of_chunk[-1, -1]
        is_whole = last - first + 1 == of_chunk.size  # nothing is left out in between
        chunk = samples[first : last + 1] if is_whole else samples[of_chunk.ravel()]
        transform = transform_in_place(chunk.reshape(-1, length).astype(np.float32))
        total += sum_of_squares(transform[:, band])
        if keep:
            kept.append(unit_phases(transform[:, band]))
    density = total * density_per_square(length, sample_rate_hz)[band] / segments
    fine = FineSpectrum(density, segments, factor, 1e-6 * sample_rate_hz / length)
    return fine, np.concatenate(kept) if keep else None
