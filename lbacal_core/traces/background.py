"""The traces of one station in one event to background spectra P_m(nu) = |F(nu)|^2 / R_r (section 3.1 of the paper).

Traces are read one after another; of each only its spectra stay in memory (and, of a few, the phases that the phase
test compares), so the memory of a station event is that of one trace and a few spectra.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_channels
from lbacal_core.traces.density import (
    COARSE_BOXES,
    FEWEST_SEGMENTS,
    LARGEST_LEAK,
    FineSpectrum,
    Flags,
    bin_weights,
    channel_frequencies,
    density_per_square,
    estimate_baseline,
    find_excess,
    find_lines,
    find_segments,
    find_station_excess,
    find_steady_phases,
    line_leakage,
    phase_stability,
    sum_of_squares,
    transform_segments,
    transform_trace,
)
from lbacal_core.traces.selection import BlockSelection, find_keyed_blocks, select_background
from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace, TraceReference, read_trace

FEWEST_BLOCKS = 20
"""Fewer background blocks than this make no spectrum: 10 % noise in a bin of 1 MHz, and no search for lines."""

FEWEST_CHANNELS = 1.0
"""A bin with fewer unflagged channels than this is filled from the neighbourhood."""

MOST_FILLED = 0.25
"""A spectrum with more of its bins filled than this is left out."""

QUIET_ADC = 0.3
"""Below this r.m.s. (ADC units) a trace is the converter's own rounding (12^-1/2 = 0.29): nothing is connected."""

MARGIN_MHZ = 2.0
"""Lines are looked for so far beyond the bins: what comes from farther is 1e-7 of its line."""

WIDE_CHANNELS = 16
"""Fine channels found by the station alone above which a trace's baseline is drawn again without them."""

PHASE_TRACES = 6
"""Traces of each dipole whose phases are kept for the phase test."""

MEGAHERTZ_GRID = np.arange(30.0, 81.0)
MEGAHERTZ_GRID.setflags(write=False)


@dataclass(frozen=True)
class CleaningSettings:
    """The settings of a user; everything else is a named constant with its reason.

    Attributes
    ----------
    frequency_mhz
        Centres of the bins of the result, MHz, evenly spaced.
    blocks
        Number of background blocks to average, spread evenly over the trace; None for all.
    resistance_ohm
        R_r, one constant that cancels in C.
    """

    frequency_mhz: Floats = field(default_factory=lambda: np.array(MEGAHERTZ_GRID))
    blocks: int | None = None
    resistance_ohm: float = 50.0

    def __post_init__(self) -> None:
        require_channels("settings", self.frequency_mhz)
        steps = np.diff(self.frequency_mhz)
        if steps.size and not np.allclose(steps, steps[0], rtol=1e-6):
            raise BadInputError(
                "settings: frequency_mhz", "evenly spaced channels", f"steps {steps.min()}-{steps.max()}"
            )
        if self.blocks is not None and self.blocks < FEWEST_BLOCKS:
            raise BadInputError("settings: blocks", f"at least {FEWEST_BLOCKS}", str(self.blocks))

    @property
    def width_mhz(self) -> float:
        """Width of a bin, MHz."""
        return float(self.frequency_mhz[1] - self.frequency_mhz[0]) if self.frequency_mhz.size > 1 else 1.0


@dataclass(frozen=True)
class PathBackground:
    """The background of one path in one event, and how it was got.

    Attributes
    ----------
    power
        Shape (freq,), ADC^2/Ohm/MHz.
    blocks
        Number of blocks averaged.
    channel_mhz, density, is_flagged
        Shape (channel,): the 1024-sample channels of the band, their mean density (ADC^2/MHz), and which were left
        out.
    line_mhz
        Shape (line,): where interference was found.
    is_filled
        Shape (freq,): bins without a clean channel, filled from the smooth spectrum.
    rms
        Root mean square of the background blocks, ADC units.
    dropped, faults
        Blocks dropped by reason, and what is wrong with the file, with counts.
    excluded
        Why this spectrum must not be used; empty if it may.
    """

    reference: TraceReference
    power: Floats
    blocks: int
    channel_mhz: Floats
    density: Floats
    is_flagged: Flags
    line_mhz: Floats
    is_filled: Flags
    rms: float
    dropped: Mapping[str, int]
    faults: Mapping[str, int]
    pulses: tuple[int, ...]
    excluded: str = ""


@dataclass(frozen=True)
class _Reduced:
    """One trace after its samples have been let go: its background without the power, and the search for lines.

    `is_judge` are the channels by whose power blocks were dropped: what they hold in the others is biased by that.
    """

    so_far: PathBackground
    fine: FineSpectrum
    baseline: Floats
    is_line: Flags
    is_judge: Flags
    segment_ids: NDArray[np.int64]
    phases: NDArray[np.complex64] | None


def measure_background(
    references: Sequence[TraceReference], settings: CleaningSettings, pulse_unix: float | None = None
) -> list[PathBackground]:
    """Measure the background spectra of the traces of one station event.

    Parameters
    ----------
    pulse_unix
        When the particle detectors expect the cosmic ray, s UTC.

    Returns
    -------
    One background a trace, in the order given; an unusable one carries the reason.
    """
    return measure_traces(map(read_trace, references), settings, pulse_unix, is_station=len(references) > 1)


def measure_traces(
    traces: Iterable[Trace], settings: CleaningSettings, pulse_unix: float | None = None, *, is_station: bool = True
) -> list[PathBackground]:
    """Measure the background spectra of one station's traces, consumed one by one.

    Parameters
    ----------
    is_station
        Whether the traces are several of one station, so that lines may be looked for in all of them together.
    """
    kept_phases = dict.fromkeys(DIPOLES, 0)
    reduced: list[_Reduced | PathBackground] = []
    for trace in traces:
        dipole = trace.reference.dipole
        keep = is_station and kept_phases[dipole] < PHASE_TRACES
        result = _reduce_trace(trace, settings, pulse_unix, keep_phases=keep)
        if isinstance(result, _Reduced) and result.phases is not None:
            kept_phases[dipole] += 1
        reduced.append(result)
    usable = [item for item in reduced if isinstance(item, _Reduced)]
    station_lines = _find_station_lines(usable) if is_station else None
    return [item if isinstance(item, PathBackground) else _finish(item, station_lines, settings) for item in reduced]


def _reduce_trace(
    trace: Trace, settings: CleaningSettings, pulse_unix: float | None, *, keep_phases: bool
) -> _Reduced | PathBackground:
    rate = trace.reference.sample_rate_hz
    searched = _searched_channels(settings, rate)
    transform, statistics = transform_trace(trace.samples, searched)
    selection = select_background(trace, pulse_unix, statistics)
    clean = np.flatnonzero(selection.is_background)
    wanted = settings.blocks or FEWEST_BLOCKS
    reason = ""
    if clean.size < wanted:
        reason = f"too few background blocks: {clean.size}, {wanted} are needed"
    elif selection.spread < QUIET_ADC:
        reason = f"dead: r.m.s. below {QUIET_ADC} ADC units"
    nothing = _begin(trace, settings, selection, channel_frequencies(BLOCK_SAMPLES, rate)[searched])
    if reason:
        return replace(nothing, excluded=reason)
    dropped = dict(selection.dropped)
    if clean.size < len(transform):
        transform = transform[clean]
    rows, segment_ids = find_segments(trace.position[clean])
    fine, phases = transform_segments(trace.samples, clean[rows], searched, rate, keep=keep_phases)
    is_line, baseline = find_lines(fine)
    to_density = density_per_square(BLOCK_SAMPLES, rate)[searched]
    strength = _line_strength(transform, to_density, fine, is_line, baseline)
    is_keyed = find_keyed_blocks(transform, strength, baseline[:: fine.factor], to_density)
    is_judge = np.zeros(strength.size, dtype=bool)
    if np.any(is_keyed) and np.sum(~is_keyed) >= wanted:
        dropped["keyed"] = int(np.sum(is_keyed))
        is_judge = strength > LARGEST_LEAK
        clean, transform = clean[~is_keyed], transform[~is_keyed]
        rows, segment_ids = find_segments(trace.position[clean])
        fine, phases = transform_segments(trace.samples, clean[rows], searched, rate, keep=keep_phases)
        is_line, baseline = find_lines(fine)
    if settings.blocks is not None:
        transform = transform[(np.arange(settings.blocks) * clean.size) // settings.blocks]
    density = sum_of_squares(transform) * to_density / len(transform)
    so_far = replace(nothing, density=density, blocks=len(transform), dropped=dropped)
    return _Reduced(so_far, fine, baseline, is_line, is_judge, segment_ids, phases)


def _line_strength(
    transform: NDArray[np.complex64], to_density: Floats, fine: FineSpectrum, is_line: Flags, baseline: Floats
) -> Floats:
    """Power of the lines, and of what stands out in the blocks alone, over the noise, shape (channel,)."""
    noise = baseline[:: fine.factor]
    strength = line_leakage(is_line, fine.density / baseline - 1.0, fine.factor, noise.size)
    excess = sum_of_squares(transform) * to_density / (len(transform) * noise) - 1.0
    is_seen = find_excess(excess + 1.0, len(transform), COARSE_BOXES)
    return np.where(is_seen, np.maximum(strength, excess), strength)


def _searched_channels(settings: CleaningSettings, rate_hz: float) -> slice:
    """The channels that are looked at: those of the bins and `MARGIN_MHZ` on either side, without 0 and the last."""
    width = 1e-6 * rate_hz / BLOCK_SAMPLES
    low = settings.frequency_mhz[0] - settings.width_mhz / 2 - MARGIN_MHZ
    high = settings.frequency_mhz[-1] + settings.width_mhz / 2 + MARGIN_MHZ
    last = BLOCK_SAMPLES // 2
    return slice(min(max(int(low / width), 1), last - 1), max(min(int(high / width) + 1, last), 2))


def _find_station_lines(usable: Sequence[_Reduced]) -> Flags | None:
    """Lines that a station sees as a whole; None where its traces cannot be compared."""
    if len(usable) < 2 or len({(item.fine.factor, item.fine.density.size) for item in usable}) != 1:
        return None
    ratios = np.stack([item.fine.density / item.baseline for item in usable])
    averages = float(np.mean([item.fine.segments for item in usable]))
    is_line = find_station_excess(ratios, averages)
    stability = np.zeros(ratios.shape[1])
    pairs = 0
    for dipole in DIPOLES:
        group = [item for item in usable if item.phases is not None and item.so_far.reference.dipole == dipole]
        for left, right in pairwise(group):
            if left.phases is None or right.phases is None:
                continue
            pair = left.phases, right.phases
            if not np.array_equal(left.segment_ids, right.segment_ids):
                _, *at = np.intersect1d(left.segment_ids, right.segment_ids, assume_unique=True, return_indices=True)
                pair = left.phases[at[0]], right.phases[at[1]]
            if len(pair[0]) >= FEWEST_SEGMENTS:
                stability += phase_stability(*pair)
                pairs += 1
    if pairs:
        is_line |= find_steady_phases(stability, pairs, usable[0].fine.channel_mhz)
    return is_line


def _finish(item: _Reduced, station_lines: Flags | None, settings: CleaningSettings) -> PathBackground:
    """Flag the channels, bin to the grid, and fill what cannot be measured."""
    fine, so_far = item.fine, item.so_far
    baseline = item.baseline
    is_line = item.is_line
    if station_lines is not None and station_lines.size == is_line.size:
        is_unknown = station_lines & ~is_line
        is_line = is_line | station_lines
        if np.sum(is_unknown) > WIDE_CHANNELS:
            baseline = estimate_baseline(fine, is_line)  # which had taken wide interference for sky
    ratio = fine.density / baseline
    leak = line_leakage(is_line, ratio - 1.0, fine.factor, so_far.density.size)
    is_flagged = (leak > LARGEST_LEAK) | item.is_judge
    shape = baseline[:: fine.factor]
    unexplained = so_far.density / shape - leak  # blocks beside a dropped one are in no segment of the search
    is_flagged |= np.convolve(find_excess(unexplained, so_far.blocks, COARSE_BOXES), np.ones(3), mode="same") > 0
    channel_mhz = so_far.channel_mhz
    power, is_filled = bin_spectrum(so_far.density - leak * shape, shape, is_flagged, channel_mhz, settings)
    excluded = ""
    if np.mean(is_filled) > MOST_FILLED:
        excluded = f"interference: {np.sum(is_filled)} of {is_filled.size} bins have no clean channel"
    elif not np.all(np.isfinite(power) & (power > 0)):
        excluded = "no power in some bins"
    line_mhz = channel_mhz[0] + _line_frequencies(is_line, ratio, fine.channel_mhz)
    return replace(
        so_far, power=power, is_flagged=is_flagged, line_mhz=line_mhz, is_filled=is_filled, excluded=excluded
    )


def bin_spectrum(
    density: Floats, shape: Floats, is_flagged: Flags, channel_mhz: Floats, settings: CleaningSettings
) -> tuple[Floats, Flags]:
    """Mean power in the bins of the grid, from the unflagged channels only.

    P = sum_k u_k c_k p_k / sum_k u_k c_k s_k x sum_k u_k s_k / sum_k u_k, with u the overlap of channel and bin,
    c = 1 for clean channels, and s the smooth shape of the spectrum: what is left of a bin on a slope stands for
    the whole bin without bias. Without flags s cancels.

    Returns
    -------
    Power, shape (freq,), ADC^2/Ohm/MHz, and which bins had too few clean channels and hold the smooth spectrum.
    """
    weights = bin_weights(channel_mhz, settings.frequency_mhz, settings.width_mhz)
    if np.any(weights.sum(axis=1) < FEWEST_CHANNELS):
        outside = settings.frequency_mhz[weights.sum(axis=1) < FEWEST_CHANNELS][0]
        expected_range = f"channels within {channel_mhz[0]:g}-{channel_mhz[-1]:g} MHz"
        raise BadInputError("settings: frequency_mhz", expected_range, f"{outside:g} MHz")
    clean = weights * ~is_flagged
    expected = weights @ shape / weights.sum(axis=1)
    seen = clean @ shape
    is_filled = clean.sum(axis=1) < FEWEST_CHANNELS
    scale = np.divide(clean @ density, seen, out=np.ones_like(seen), where=~is_filled & (seen > 0))
    return expected * scale / settings.resistance_ohm, is_filled


def _line_frequencies(is_line: Flags, ratio: Floats, channel_mhz: float) -> Floats:
    """The strongest channel of every run of flagged channels, MHz."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_line.astype(np.int8), [0]])))
    peaks = [start + int(np.argmax(ratio[start:stop])) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    return np.array(peaks, dtype=float) * channel_mhz


def _begin(trace: Trace, settings: CleaningSettings, selection: BlockSelection, channel_mhz: Floats) -> PathBackground:
    """The background of a trace in which no power was measured yet."""
    bins = settings.frequency_mhz.size
    return PathBackground(
        reference=trace.reference,
        power=np.zeros(bins),
        blocks=int(np.sum(selection.is_background)),
        channel_mhz=channel_mhz,
        density=np.zeros(channel_mhz.size),
        is_flagged=np.zeros(channel_mhz.size, dtype=bool),
        line_mhz=np.array([]),
        is_filled=np.zeros(bins, dtype=bool),
        rms=selection.rms,
        dropped=selection.dropped,
        faults=trace.faults,
        pulses=selection.pulses,
    )
