"""Recognises anomalous spectra before a fit: saturated or dead receivers, lightning, broken numbers.

Each path is compared with itself alone. The logarithm of its band power is fitted robustly with a Fourier series in
LST, which describes the daily variation of the sky whatever the sky model says; an event that is off by more than
`CUT_SIGMA` robust standard deviations and by at least a fifth is anomalous, and so is one whose single channel is off
by a factor of three. What has less than a tenth of the usual power is dead, and left out however long it lasts. Any
other anomalous spectrum is left out of fits unless it belongs to a state of the path and not to an event: what lasts is
what drift and `investigate` are to find. It stays in the database, and the rule is applied anew in each fit. The paper
leaves out events with anomalous power too (section 3.1 of Mulrey et al. 2019).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.curves import Anomaly
from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.linear import solve_symmetric
from lbacal_core.spectra.blocks import SpectraBlock

CUT_SIGMA = 6.0
SMALLEST_DEPARTURE = float(np.log(1.2))
"""A smaller departure of one event among 60 or more moves C by less than 0.2 %."""
SMALLEST_OF_CHANNEL = float(np.log(3.0))
"""The daily variation of a channel differs from that of the band by less than a third."""
CUT_SIGMA_OF_CHANNEL = 8.0
GROSS = float(np.log(2.0))
"""No cause of the catalogue changes the power of a path by a factor of two: beyond it, what lasts is left out too."""
DEAD = float(np.log(0.1))
"""With less than a tenth of its usual power a path is dead: no sky and no cause of the catalogue is so weak."""
LASTING_EVENTS = 10
"""So many events of a path in a row, four days of a LOFAR year, are a state of the path."""
LARGEST_SHARE = 0.05
"""A path with a larger share of anomalous spectra has no usual power to compare with, and keeps them all."""
FAR = float(np.log(3.0))
"""The daily variation of the sky is a factor of two: so far from the stored power of its path is another gain, or no
power at all."""
SHARE_OF_STATE = 0.75
"""A level that lasts shows in so many spectra: near `FAR` the daily variation hides the others."""
FEWEST_EVENTS = 20
"""With fewer events the usual power of a path is not known, and nothing is left out."""
NEARER = 0.8
"""Share of the limits from which on a spectrum that is judged by itself may be one that is left out."""
LARGEST_SHARE_OF_LATER = 0.05
"""Events over those that were screened together, which may be judged by themselves: noise levels of 900 events move by
1 %."""

PATHS_AT_ONCE = 6
"""Paths that are compared together: 6 x 900 x 51 numbers are 2.2 MB."""
HARMONICS = 3
_EVENTS_PER_HARMONIC = 30
_TYPICAL_EVENTS = 101
_ROUNDS = 5
_REACH = 4.685
_FIRST_REACH = 9.0
_CLIP = 3.0
_LARGEST_LOGARITHM = 700.0
_CHANNELS_OF_LEVEL = 10
_MAD_TO_SIGMA = 1.482602218505602
Number = TypeVar("Number", np.float32, np.float64)


@dataclass(frozen=True)
class Screened:
    """The spectra of a block without those that are left out, and what was found.

    `is_steady` says of each antenna, shape (antenna,), whether its anomalous spectra are few enough to be exceptions.
    """

    block: SpectraBlock
    anomalies: tuple[Anomaly, ...]
    is_steady: NDArray[np.bool_]


def may_be_left_out(departure: Floats, scatter: Floats) -> NDArray[np.bool_]:
    """Whether a screening of all events may leave out one of some events of a path, shape (path,).

    Parameters
    ----------
    departure
        Logarithm of the power over the expected one, shape (path, event, freq); 0 where there is no spectrum.
    scatter
        Standard deviation of the band power of an event, relative, shape (path,).
    """
    cut = NEARER * np.maximum(CUT_SIGMA * scatter, SMALLEST_DEPARTURE)[:, None]
    is_off = np.abs(departure.mean(axis=2)) > cut
    is_off |= np.any(np.abs(departure) > NEARER * SMALLEST_OF_CHANNEL, axis=2)
    return np.asarray(np.any(is_off, axis=1))


def screen_block(block: SpectraBlock, longitude_deg: float) -> Screened:
    """Find the anomalous spectra of a block and leave out those that are exceptions.

    A path is judged by its own spectra alone, so that its fit depends on nothing else.
    """
    dead = find_dead(block)
    living = replace(block, is_present=block.is_present & ~dead)
    is_judged = living.is_present.sum(axis=1) >= FEWEST_EVENTS
    found: list[Anomaly] = []
    is_left_out, is_steady = np.zeros_like(block.is_present), np.ones_like(is_judged)
    if not np.any(is_judged):
        return Screened(block, (), is_steady)
    departure, is_off = _compare_with_usual(living, longitude_deg)
    is_off &= living.is_present & is_judged[:, None]
    dead &= is_judged[:, None]
    for k in np.flatnonzero((is_off | dead).any(axis=1)):
        events = np.flatnonzero(is_off[k] | dead[k])
        sizes, channels = _describe(departure[k, events])
        alive = ~dead[k, events]
        kept = np.full(events.size, None)
        kept[alive] = _reasons_to_keep(is_off[k, living.is_present[k]], np.abs(sizes[alive]) > GROSS)
        factors = np.exp(np.clip(sizes, -_LARGEST_LOGARITHM, _LARGEST_LOGARITHM)).tolist()
        for event, factor, channel, why in zip(events, factors, channels, kept, strict=True):
            frequency = None if channel is None else float(block.frequency_mhz[channel])
            owner = (block.station, int(block.antennas[k]), block.dipole)
            found.append(Anomaly(str(block.event_id[event]), *owner, factor, frequency, why))
        is_steady[k] = is_off[k].sum() <= LARGEST_SHARE * living.is_present[k].sum()
        is_left_out[k, events] = [why is None for why in kept]
    return Screened(leave_out(block, is_left_out), tuple(found), is_steady)


def find_dead(block: SpectraBlock) -> NDArray[np.bool_]:
    """Find the spectra without sky, shape (path, event): half of a path's spectra at the most.

    They are set apart first, because the robust fit of the daily variation does not stand many that are so far off.
    """
    level = np.where(block.is_present, measure_level(block.power), np.nan)
    is_judged = block.is_present.sum(axis=1) >= FEWEST_EVENTS
    return np.asarray((np.nan_to_num(level - median_over(level, 1)[:, None]) < DEAD) & is_judged[:, None])


def measure_level(power: Floats) -> Floats:
    """The level of spectra, shape (..., freq): ln of the median power of some channels over the band, shape (...)."""
    some = power[..., :: max(1, power.shape[-1] // _CHANNELS_OF_LEVEL)]
    return np.asarray(np.log(np.median(some, axis=-1)))


def find_lasting(is_far: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the spectra of a path that came at another level have shown that its level is that, shape (event,).

    Those of its newest events if from some event on there are `LASTING_EVENTS` of them or more, and `SHARE_OF_STATE`
    of all; those of its oldest events in the same way.
    """
    lasting = np.zeros_like(is_far)
    for own, found in ((is_far, lasting), (is_far[::-1], lasting[::-1])):
        since = np.cumsum(own[::-1])[::-1]
        is_state = own & (since >= LASTING_EVENTS) & (since >= SHARE_OF_STATE * np.arange(own.size, 0, -1))
        if np.any(is_state):
            found[np.argmax(is_state) :] |= own[np.argmax(is_state) :]
    return lasting


def _compare_with_usual(block: SpectraBlock, longitude_deg: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Logarithm of power over the path's usual power at that LST, shape (path, event, freq), and which are off."""
    departure, band = np.empty_like(block.power), np.empty(block.is_present.shape)
    typical_events = _events_spread_in_time(block.is_present)
    # a few paths at once, whose spectra stay in a core's cache
    parts = [slice(k, k + PATHS_AT_ONCE) for k in range(0, len(departure), PATHS_AT_ONCE)]
    for part in parts:
        own = np.log(block.power[part], out=departure[part])
        own -= np.median(np.take_along_axis(own, typical_events[part], axis=1), axis=1, keepdims=True)
        # the mean of 51 channels, in which a single broken one does not count for more than a factor of 20
        band[part] = np.clip(own, -_CLIP, _CLIP).mean(axis=2)
    usual = predict_daily_variation(band, block.time_unix, block.is_present, longitude_deg)
    band -= usual
    noisier = _noise_of_few_blocks(block)
    of_band = robust_sigma(np.where(block.is_present, band, np.nan))[:, None]
    is_off = np.abs(band) > np.maximum(CUT_SIGMA * of_band * noisier, SMALLEST_DEPARTURE)
    for part in parts:
        own = departure[part]
        own -= usual[part, :, None]
        size = np.abs(own)
        of_channel = _MAD_TO_SIGMA * np.median(np.take_along_axis(size, typical_events[part], axis=1), axis=1)
        cut = np.maximum(CUT_SIGMA_OF_CHANNEL * of_channel, SMALLEST_OF_CHANNEL)
        is_off[part] |= np.any(size > cut[:, None, :] * noisier[part, :, None], axis=2)
    return departure, is_off


def leave_out(block: SpectraBlock, is_left_out: NDArray[np.bool_]) -> SpectraBlock:
    """Leave some spectra, marked in shape (path, event), out of the block."""
    if not np.any(is_left_out):
        return block
    return replace(
        block,
        power=np.where(is_left_out[:, :, None], 1.0, block.power),
        is_present=block.is_present & ~is_left_out,
        blocks=np.where(is_left_out, 0, block.blocks),
    )


def _describe(departure: Floats) -> tuple[Floats, list[int | None]]:
    """By how much spectra are off, ln of a factor, shape (event,), and in which channel if it is not the whole band."""
    of_band = np.median(departure, axis=1)
    worst = np.argmax(np.abs(departure), axis=1)
    of_channel = departure[np.arange(len(worst)), worst]
    is_single = (np.abs(of_channel - of_band) > SMALLEST_OF_CHANNEL) & (np.abs(of_band) < GROSS)
    channels = [int(channel) if single else None for channel, single in zip(worst, is_single, strict=True)]
    return np.where(is_single, of_channel, of_band), channels


def _reasons_to_keep(is_off: NDArray[np.bool_], is_gross: NDArray[np.bool_]) -> list[str | None]:
    """Why each anomalous spectrum of a path is fitted nevertheless; None for those that are left out.

    Parameters
    ----------
    is_off
        Shape (event,), the events of a path in order of time.
    is_gross
        One entry for each anomalous one of them.
    """
    count = int(is_off.sum())
    if count > LARGEST_SHARE * is_off.size:
        return [f"{count} of the {is_off.size} spectra of this path are like this"] * count
    edges = np.flatnonzero(np.diff(is_off.astype(int), prepend=0, append=0)).reshape(-1, 2)
    lengths = np.repeat(edges[:, 1] - edges[:, 0], edges[:, 1] - edges[:, 0])
    return [
        f"it lasts for {length} events" if length >= LASTING_EVENTS and not gross else None
        for length, gross in zip(lengths, is_gross, strict=True)
    ]


def _events_spread_in_time(is_present: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The numbers of some events of each path, enough for the median of a channel, shape (path, event, 1)."""
    count = is_present.sum(axis=1, keepdims=True)
    in_time = np.argsort(~is_present, axis=1, kind="stable")
    picked = ((np.arange(_TYPICAL_EVENTS) + 0.5) / _TYPICAL_EVENTS * count).astype(int)
    return np.take_along_axis(in_time, picked, axis=1)[:, :, None]


def _noise_of_few_blocks(block: SpectraBlock) -> Floats:
    """How much wider than usual a spectrum scatters because it averages fewer blocks, shape (path, event), >= 1."""
    typical = np.median(block.blocks[block.is_present])
    return np.asarray(np.sqrt(np.maximum(typical / np.maximum(block.blocks, 1), 1.0)))


def predict_daily_variation(
    level: Floats, time_unix: Floats, is_present: NDArray[np.bool_], longitude_deg: float
) -> Floats:
    """Fit a Fourier series in LST to levels, without outliers, and evaluate it.

    Least squares with Tukey's biweight at 4.685 robust sigma, starting from the median.

    Parameters
    ----------
    level, is_present
        ln of power, shape (path, event), any finite number where absent; and where it is there.

    Returns
    -------
    Shape (path, event).
    """
    angle = 2 * np.pi * local_sidereal_time(time_unix, longitude_deg) / 24.0
    most = min(HARMONICS, int(is_present.sum(axis=1).max()) // _EVENTS_PER_HARMONIC)
    order = np.arange(1, most + 1)
    design = np.hstack([np.ones((angle.size, 1)), np.cos(angle[:, None] * order), np.sin(angle[:, None] * order)])
    columns = design.shape[1]
    squares = (design[:, :, None] * design[:, None, :]).reshape(angle.size, -1)
    known = np.where(is_present, level, np.nan)
    predicted = np.zeros_like(level)
    predicted[:] = np.nan_to_num(median_over(known, 1))[:, None]
    for round_number in range(_ROUNDS):
        residual = level - predicted
        scale = np.maximum(robust_sigma(np.where(is_present, residual, np.nan)), 1e-6)[:, None]
        reach = (_REACH if round_number else _FIRST_REACH) * scale
        weight = is_present * np.clip(1.0 - (residual / reach) ** 2, 0.0, None) ** 2
        normal = (weight @ squares).reshape(-1, columns, columns)
        target = (weight * level) @ design
        predicted = solve_symmetric(normal, target[:, :, None])[:, :, 0] @ design.T
    return predicted


def robust_sigma(values: Floats) -> Floats:
    """1.48 times the median absolute deviation of each row, NaN left out, shape (path,); 0 for a row of NaN."""
    centred = np.abs(values - median_over(values, 1)[:, None])
    return np.asarray(_MAD_TO_SIGMA * np.nan_to_num(median_over(centred, 1)))


def median_over(values: NDArray[Number], axis: int) -> NDArray[Number]:
    """Median of the known values along an axis, which the shape loses, NaN where there is none.

    Some times faster than `nanmedian`.
    """
    ordered = np.sort(np.moveaxis(values, axis, -1), axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    upper, lower = np.minimum(count // 2, values.shape[axis] - 1), np.maximum((count - 1) // 2, 0)
    pair = np.take_along_axis(ordered, np.concatenate([lower, upper], axis=-1), axis=-1)
    return np.asarray(np.where(count[..., 0] > 0, pair.mean(axis=-1), np.nan), dtype=values.dtype)
