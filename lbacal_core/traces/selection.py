"""Which blocks of a trace are background: intact, not saturated, away from pulses, without bursts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from astropy.stats import mad_std
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.traces.density import BlockStatistics, transform_trace
from lbacal_core.traces.trace import ADC_HIGHEST, ADC_LOWEST, BLOCK_SAMPLES, Trace

PULSE_REACH = 5
"""Blocks on either side of a pulse that are left out (section 3.1 of the paper)."""

PULSE_SIGMA = 7.0
"""A sample beyond this many sigma is a pulse or a glitch: Gaussian noise has one in 1000 events of 96 traces. What
stays below adds less than 1e-4 to the power: 7^2 x 5 samples in 400,000."""

BURST_SIGMA = 8.0
"""A block whose power exceeds the median by this many robust sigma (20 % and more) is a burst, which begins and ends in
the blocks beside it."""


KEYED_LEVEL = 20.0
"""A channel is on in a block if it has this many times its noise there: chance, 2e-9. Switching a carrier on or off
spreads it over the band as 1/d^2 at d channels, which no window prevents."""

SWITCHED_LEVEL = 12.0
SWITCHED_SHARE = 0.007
ON_LEVEL = 5.0
"""Where one block in 140 exceeds the first (chance in 400 blocks, 1e-8), a transmitter is switched, and the channel is
on in all blocks above the second (chance, 0.7 %). A lower threshold does harm: it removes the blocks in which a
weak line happens to be strong, and the search then misses the rest of the line."""

OFF_LEVEL = 2.0
"""A channel whose median is above this many times its noise (pure noise: 0.7) is on most of the time: a carrier,
perhaps modulated, whose fluctuations must not be taken for keying."""

MOST_KEYED = 0.5
KEYED_CHANNELS = 16
KEYED_STRENGTH = 0.1


@dataclass(frozen=True)
class BlockSelection:
    """The background blocks of a trace and why others are not.

    Attributes
    ----------
    is_background
        Shape (block,).
    dropped
        Number of blocks by reason; a block counts for its first reason.
    pulses
        Block of every pulse, known or found, counted from the full second in which the trace begins.
    mean, mean_square
        Shape (block,), ADC and ADC^2.
    """

    is_background: NDArray[np.bool_]
    dropped: Mapping[str, int]
    pulses: tuple[int, ...]
    mean: Floats
    mean_square: Floats

    @property
    def rms(self) -> float:
        """Root mean square of the background, ADC units."""
        return float(np.sqrt(np.mean(self.mean_square[self.is_background]))) if np.any(self.is_background) else 0.0

    @property
    def spread(self) -> float:
        """Standard deviation of the background, ADC units."""
        if not np.any(self.is_background):
            return 0.0
        mean = float(np.mean(self.mean[self.is_background]))
        return float(np.sqrt(max(self.rms**2 - mean**2, 0.0)))


def select_background(
    trace: Trace, pulse_unix: float | None = None, statistics: BlockStatistics | None = None
) -> BlockSelection:
    """Choose the background blocks of a trace.

    Parameters
    ----------
    pulse_unix
        When the cosmic ray is expected (from the particle detectors), s UTC; the blocks around it go, seen or not.
    statistics
        Statistics of the blocks, where they are known already.
    """
    statistics = statistics or transform_trace(trace.samples)[1]
    highest, lowest, mean_square = statistics.highest, statistics.lowest, statistics.mean_square
    typical = np.median(mean_square[trace.is_intact]) if np.any(trace.is_intact) else 0.0
    centre = float(np.median(statistics.mean))
    variance = max(typical - centre**2, 0.0)
    peak = np.maximum(highest - centre, centre - lowest)

    is_saturated = (highest >= ADC_HIGHEST) | (lowest <= ADC_LOWEST)
    is_peak = trace.is_intact & (peak > PULSE_SIGMA * np.sqrt(variance)) & (variance > 0)
    pulses = list(trace.position[is_peak])
    if pulse_unix is not None:
        start = trace.reference.start_s
        pulses.append(int((pulse_unix - start) * trace.reference.sample_rate_hz // BLOCK_SAMPLES))
    is_near = np.zeros(len(peak), dtype=bool)
    if pulses:
        centres = np.unique(np.array(pulses, dtype=np.int64))
        after = np.searchsorted(centres, trace.position)
        left = np.abs(trace.position - centres[np.clip(after - 1, 0, None)])
        right = np.abs(trace.position - centres[np.clip(after, None, len(centres) - 1)])
        is_near = np.minimum(left, right) <= PULSE_REACH

    spread = float(mad_std(mean_square[trace.is_intact])) if np.any(trace.is_intact) else 0.0
    is_burst = mean_square - typical > BURST_SIGMA * spread
    is_burst[1:] |= is_burst[:-1].copy()
    is_burst[:-1] |= is_burst[1:].copy()
    reasons = {"damaged": ~trace.is_intact, "saturated": is_saturated, "pulse": is_near, "burst": is_burst}
    is_background = np.ones(len(peak), dtype=bool)
    dropped = {}
    for reason, is_bad in reasons.items():
        count = int(np.sum(is_bad & is_background))
        if count:
            dropped[reason] = count
        is_background &= ~is_bad
    return BlockSelection(
        is_background, dropped, tuple(np.unique(pulses).astype(int).tolist()), statistics.mean, mean_square
    )


def find_keyed_blocks(
    transform: NDArray[np.complex64], line_strength: Floats, noise: Floats, to_density: Floats
) -> NDArray[np.bool_]:
    """Find the blocks in which a transmitter is on that is off in most: those and their neighbours hold its switching.

    Parameters
    ----------
    transform
        Shape (block, channel): windowed transform of the blocks.
    line_strength
        Shape (channel,): mean power of lines over the noise.
    noise
        Shape (channel,): noise density, ADC^2/MHz.
    to_density
        Shape (channel,): from |F|^2 to density.

    Returns
    -------
    Shape (block,). Transmitters that are on in more than half of the blocks are not counted: nothing would be left.
    """
    padded = np.pad(line_strength, 1)
    is_peak = (line_strength >= padded[:-2]) & (line_strength >= padded[2:]) & (line_strength > KEYED_STRENGTH)
    channels = np.flatnonzero(is_peak)
    channels = channels[np.argsort(line_strength[channels])[-KEYED_CHANNELS:]]
    is_keyed = np.zeros(len(transform), dtype=bool)
    if channels.size == 0:
        return is_keyed
    seen = transform[:, channels]
    power = (seen.real**2 + seen.imag**2) * (to_density[channels] / noise[channels])
    is_mostly_off = np.median(power, axis=0) < OFF_LEVEL
    is_switched = np.mean(power > SWITCHED_LEVEL, axis=0) > SWITCHED_SHARE
    is_on = (power > KEYED_LEVEL) | (is_switched & (power > ON_LEVEL))
    is_on = is_on[:, is_mostly_off & np.any(is_on, axis=0)]
    for channel in np.argsort(is_on.mean(axis=0)):
        candidate = is_keyed | is_on[:, channel]
        candidate[1:] |= is_on[:-1, channel]
        candidate[:-1] |= is_on[1:, channel]
        if candidate.mean() <= MOST_KEYED:
            is_keyed = candidate
    return is_keyed
