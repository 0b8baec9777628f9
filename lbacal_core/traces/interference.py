"""Narrow-band interference: found by its excess in a fine spectrum and by its steady phase between antennas.

The search runs on segments of up to 16 consecutive blocks (12.2 kHz channels), finer than the 1024-sample blocks of the
result: a carrier stands out in proportion to the resolution, so lines are found down to about 0.5 % of the noise in
1 MHz, five times less than a search in the blocks themselves could.

1. Excess: mean power over a local median, tested by itself and in boxes of 2, 4, 8, 16 channels, what one box finds
   being replaced before the next: the idea of SumThreshold (Offringa et al. 2010, MNRAS 405, 155), with thresholds
   from the exact Gamma distribution of averaged noise power. Once for every trace, once for a station's mean.
2. Phase stability: noise has a random phase difference between two antennas, a transmitter a constant one
   (Corstanje et al. 2016, A&A 590, A41): |mean over segments of exp(i delta phi)|^2, summed over antenna pairs, against
   the median of its neighbours in frequency, because the sky too is slightly correlated between near antennas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from astropy.stats import mad_std
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import gammainccinv, gammaincinv

from lbacal_core.grids import Floats
from lbacal_core.traces.density import HANN_NEIGHBOUR_CORRELATION, line_response

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

    Traces share the sky, so their noise is not quite independent: its level is measured where it exceeds theory.
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
    """A transform with all amplitudes set to 1 (0 stays 0)."""
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
        Fine channels in a coarse one.
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
