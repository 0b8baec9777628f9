"""Drift of a year with some events more: what of the new ones may be taken without looking at the year again.

An event's modes against a fixed reference depend on no other event (`events`). What depends on the whole year is the
screening: a spectrum that may be left out, and a path that gets so many events that it is screened, are left to a
reading of the whole year.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lbacal_core.calibration.continued import NEARER
from lbacal_core.curves import CalibrationCurve
from lbacal_core.drift.events import EventModes, measure_event_modes, predict_power
from lbacal_core.instrument import Instrument
from lbacal_core.screening import (
    CUT_SIGMA,
    FEWEST_EVENTS,
    SMALLEST_DEPARTURE,
    SMALLEST_OF_CHANNEL,
    robust_sigma,
)
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock

LARGEST_SHARE = 0.05
"""Events of a year that may be added to those that were screened together, over these."""


def add_events(
    kept: EventModes,
    new: SpectraBlock,
    references: Mapping[int, CalibrationCurve],
    instrument: Instrument,
    sky_power: SkyPower,
) -> EventModes | None:
    """Events of one polarisation of a station, and some more; None where the whole year is to be read.

    Parameters
    ----------
    kept
        Those that were measured.
    """
    antennas, time_unix, ln_c = kept.antennas, kept.time_unix, kept.ln_c
    found = measure_event_modes(new, references, instrument, sky_power)
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
    expected = predict_power(
        new, references, instrument, sky_power, found.antennas[judged], np.nanmedian(ln_gain, axis=1)
    )
    departure = np.log(new.power[rows][judged] / expected)
    departure[~new.is_present[rows][judged]] = 0.0
    centred = ln_gain - np.nanmedian(ln_gain, axis=1, keepdims=True)
    cut = NEARER * np.maximum(CUT_SIGMA * robust_sigma(centred), SMALLEST_DEPARTURE)
    if np.any(np.abs(departure.mean(axis=2)) > cut[:, None]) or np.any(
        np.abs(departure) > NEARER * SMALLEST_OF_CHANNEL
    ):
        return None
    times = np.concatenate([time_unix, found.time_unix])
    whole = np.full((antennas.size, times.size, ln_c.shape[2]), np.nan)
    whole[:, : time_unix.size] = ln_c
    whole[at, time_unix.size :] = found.ln_c
    order = np.argsort(times, kind="stable")
    return EventModes(antennas, times[order], whole[:, order], kept.centre)
