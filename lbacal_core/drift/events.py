"""A path's calibration by one event, relative to a fixed one: its level and two modes along frequency.

With the calibration of a reference window held fixed, the chain predicts the power of every event. What the recorded
power differs by is put down to a gain g in front of N_RCU (eq. full_chain of Mulrey et al. 2019, A -> g A),

    P = g S + B,    S = (P_sky + N_LNA) G_ant / C^2,    B = N_RCU S_adc G_RCU + N_ADC,

so that the calibration factor of the event is C g^(-1/2): far sharper than fitting everything anew. The gain is the
mean over channels with weights (S / P)^2: where half of the power is receiver noise, a gain shows half as much over the
same relative noise. What is left of g(nu) is fitted with two Legendre modes of frequency, a tilt and a curvature, both
taken less their weighted mean so that they leave the gain alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.years import gain_modes
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.linear import solve_symmetric
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded, SpectraBlock, split_into_blocks
from lbacal_core.spectra.screening import DEAD, FEWEST_EVENTS, may_be_left_out, robust_sigma, screen_block

FAINTEST = 0.7
"""Share of the noise of the receiver below which nothing is recorded: that noise is known to some ten percent."""
MODES = ("gain", "tilt", "curvature")
"""What is followed: ln C in the mean over the band, and the coefficients of the Legendre polynomials 1 and 2 in it."""


@dataclass(frozen=True)
class EventModes:
    """ln(C / C_reference) of every path and event of a block.

    Attributes
    ----------
    antennas
        Shape (antenna,), those with a reference.
    time_unix
        Shape (event,), rising.
    ln_c
        Shape (antenna, event, mode), NaN where nothing was measured; in single precision where it was kept.
    """

    antennas: NDArray[np.int64]
    time_unix: Floats
    ln_c: Floats | NDArray[np.float32]


def measure_event_modes(
    block: SpectraBlock, references: Mapping[int, CalibrationCurve], simulation: Simulation
) -> EventModes:
    """Measure every event against converged reference curves, by antenna number."""
    rows = np.flatnonzero(np.isin(block.antennas, [a for a, curve in references.items() if curve.c is not None]))
    curves = [references[int(antenna)] for antenna in block.antennas[rows]]
    modes = gain_modes(block.frequency_mhz)[1:]
    if not curves:
        empty = np.empty((0, block.time_unix.size, len(MODES)))
        return EventModes(block.antennas[rows], block.time_unix, empty)
    has_value = np.array([curve.has_value for curve in curves])
    sky = simulation.sky_at(block.station, block.dipole, block.time_unix)
    signal, behind = simulation.split_power(curves, sky)
    weight = (signal / (signal + behind)) ** 2 * has_value[:, None, :]
    ratio = (block.power[rows] - behind) / signal
    total = weight.sum(axis=2)
    gain = (weight * ratio).sum(axis=2) / total
    is_recorded = block.is_present[rows] & (block.power[rows].sum(axis=2) > FAINTEST * behind.sum(axis=2))
    is_alive = gain > np.exp(DEAD)
    is_known = is_recorded & is_alive

    ln_c = np.full((*gain.shape, len(MODES)), np.nan)
    # a receiver whose antenna is dead records no sky: that is one step, and its noise is none
    ln_c[is_recorded & ~is_alive] = (-0.5 * DEAD, 0.0, 0.0)
    ln_c[is_known, 0] = -0.5 * np.log(gain[is_known])
    ln_c[is_known, 1:] = -0.5 * _fit_modes(ratio / np.where(is_known, gain, 1.0)[:, :, None], weight, modes)[is_known]
    return EventModes(block.antennas[rows], block.time_unix, ln_c)


def measure_spectra(
    spectra: Recorded, references: Callable[[str, str], Mapping[int, CalibrationCurve]], simulation: Simulation
) -> list[tuple[str, str, EventModes]]:
    """Measure the screened events of each station and dipole against its reference curves, by antenna number."""
    found = []
    for block in split_into_blocks(spectra):
        screened = screen_block(block, simulation.instrument.at_station(block.station).longitude_deg).block
        curves = references(block.station, block.dipole)
        found.append((block.station, block.dipole, measure_event_modes(screened, curves, simulation)))
    return found


def predict_power(
    block: SpectraBlock,
    references: Mapping[int, CalibrationCurve],
    simulation: Simulation,
    antennas: NDArray[np.int64],
    ln_gain: Floats,
) -> Floats:
    """The power of some antennas in the events of a block, ln g of each held fixed, shape (antenna, event, freq)."""
    curves = [references[int(antenna)] for antenna in antennas]
    if not curves:
        return np.empty((0, block.time_unix.size, block.frequency_mhz.size))
    sky = simulation.sky_at(block.station, block.dipole, block.time_unix)
    signal, behind = simulation.split_power(curves, sky)
    return np.asarray(np.exp(ln_gain)[:, None, None] * signal + behind)


def _fit_modes(ratio: Floats, weight: Floats, modes: Floats) -> Floats:
    """Coefficients of the modes in g(nu) / g beside a constant, shape (antenna, event, 2), weighted least squares."""
    columns = np.vstack([np.ones(modes.shape[1]), modes])
    products = (columns[:, None, :] * columns[None, :, :]).reshape(-1, modes.shape[1])
    normal = (weight @ products.T).reshape(*weight.shape[:2], 3, 3)
    target = (weight * ratio) @ columns.T
    return solve_symmetric(normal, target[..., None])[..., 1:, 0]


# The mean of a path's events in a month: one gain and two modes along frequency, against a fixed calibration.

MIN_EVENTS = 5
"""Fewer events in a month leave its gain worse than 2.5 %."""


@dataclass(frozen=True)
class MonthlyRatios:
    """C of each month over that of the reference.

    Attributes
    ----------
    antennas
        Shape (antenna,), those with a reference.
    months
        Shape (month,), datetime64[M], rising.
    c_ratio, c_ratio_sigma
        Shape (antenna, month); NaN where a month has too few events.
    shape, shape_sigma
        Tilt and curvature of ln C, shape (antenna, month, 2); NaN where a month has too few events.
    events
        Shape (antenna, month).
    """

    antennas: NDArray[np.int64]
    months: NDArray[np.datetime64]
    c_ratio: Floats
    c_ratio_sigma: Floats
    shape: Floats
    shape_sigma: Floats
    events: NDArray[np.int64]


def average_months(modes: EventModes) -> MonthlyRatios:
    """Average the events of every month.

    The error of a month is the scatter of its path's events over the whole block divided by the root of their number:
    a month has too few events to know its own scatter.
    """
    months, starts = find_months(modes.time_unix)
    is_known = np.isfinite(modes.ln_c[..., 0])
    values = modes.ln_c.astype(float)
    values[..., 0] = np.exp(-2.0 * values[..., 0])  # the power gain, whose mean is C^-2
    values[~is_known] = 0.0
    events = np.add.reduceat(is_known.astype(np.int64), starts, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.add.reduceat(values, starts, axis=1) / events[..., None]
        squares = np.add.reduceat(values**2, starts, axis=1) - events[..., None] * mean**2
        freedom = np.maximum(is_known.sum(axis=1) - (events > 0).sum(axis=1), 1)
        scatter = np.sqrt(np.maximum(np.nansum(squares, axis=1), 0.0) / freedom[:, None])
        sigma = scatter[:, None, :] / np.sqrt(events)[..., None]
        is_good = (events >= MIN_EVENTS) & (mean[..., 0] > 0)
        mean[~is_good] = sigma[~is_good] = np.nan
        c_ratio, c_ratio_sigma = mean[..., 0] ** -0.5, 0.5 * sigma[..., 0] * mean[..., 0] ** -1.5
    return MonthlyRatios(modes.antennas, months, c_ratio, c_ratio_sigma, mean[..., 1:], sigma[..., 1:], events)


def find_months(time_unix: Floats) -> tuple[NDArray[np.datetime64], NDArray[np.int64]]:
    """The months with events, and the first event of each: shape (month,) both.

    Parameters
    ----------
    time_unix
        Shape (event,), rising.
    """
    months, starts = np.unique(time_unix.astype("datetime64[s]").astype("datetime64[M]"), return_index=True)
    return months, starts


# Drift of a year with some events more: what of the new ones may be taken without looking at the year again.
#
# An event's modes against a fixed reference depend on no other event (`events`). What depends on the whole year is the
# screening: a spectrum that may be left out, and a path that gets so many events that it is screened, are left to a
# reading of the whole year.


def add_events(
    kept: EventModes, new: SpectraBlock, references: Mapping[int, CalibrationCurve], simulation: Simulation
) -> EventModes | None:
    """Events of one polarisation of a station, and some more; None where the whole year is to be read.

    Parameters
    ----------
    kept
        Those that were measured.
    """
    antennas, time_unix, ln_c = kept.antennas, kept.time_unix, kept.ln_c.astype(float)
    found = measure_event_modes(new, references, simulation)
    at = np.searchsorted(antennas, found.antennas)
    if found.antennas.size == 0 or at.max() >= antennas.size or np.any(antennas[at] != found.antennas):
        return None
    rows = np.isin(new.antennas, found.antennas)
    old = ln_c[at]
    before, more = np.isfinite(old[..., 0]).sum(axis=1), new.is_present[rows].sum(axis=1)
    if np.any((before < FEWEST_EVENTS) & (before + more >= FEWEST_EVENTS)):
        return None
    judged = before >= FEWEST_EVENTS
    ln_gain = -2.0 * old[judged, :, 0]
    expected = predict_power(new, references, simulation, found.antennas[judged], np.nanmedian(ln_gain, axis=1))
    departure = np.log(new.power[rows][judged] / expected)
    departure[~new.is_present[rows][judged]] = 0.0
    centred = ln_gain - np.nanmedian(ln_gain, axis=1, keepdims=True)
    if np.any(may_be_left_out(departure, robust_sigma(centred))):
        return None
    times = np.concatenate([time_unix, found.time_unix])
    whole = np.full((antennas.size, times.size, ln_c.shape[2]), np.nan)
    whole[:, : time_unix.size] = ln_c
    whole[at, time_unix.size :] = found.ln_c
    order = np.argsort(times, kind="stable")
    return EventModes(antennas, times[order], whole[:, order])
