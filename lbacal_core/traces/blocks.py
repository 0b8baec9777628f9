"""The samples of a trace gone through: statistics and transform of its blocks, and the finer spectrum of segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.traces.density import CHUNK_SAMPLES, density_per_square, hann, sum_of_squares, transform_in_place
from lbacal_core.traces.interference import FineSpectrum, unit_phases
from lbacal_core.traces.trace import BLOCK_SAMPLES

FACTORS = (16, 8, 4, 2)
FEWEST_SEGMENTS = 12
"""Segments are as long as leaves this many of them: below, a single carrier cannot be told from noise."""


@dataclass(frozen=True)
class BlockStatistics:
    """What the choice of blocks needs to know of each.

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
