"""One gain per path and month against a fixed calibration: far sharper than fitting everything anew each month.

With the calibration of a reference window held fixed, the chain predicts the power of every later event. What the
recorded power differs by is put down to a gain g in front of N_RCU (eq. full_chain of Mulrey et al. 2019, A -> g A),

    P = g S + B,    S = (P_sky + N_LNA) G_ant / C^2,    B = N_RCU S_adc G_RCU + N_ADC,

so that the calibration factor of the month is C g^(-1/2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock

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
    events
        Shape (antenna, month).
    """

    antennas: NDArray[np.int64]
    months: NDArray[np.datetime64]
    c_ratio: Floats
    c_ratio_sigma: Floats
    events: NDArray[np.int64]


def measure_monthly_ratios(
    block: SpectraBlock, references: Mapping[int, CalibrationCurve], instrument: Instrument, sky_power: SkyPower
) -> MonthlyRatios:
    """Measure C of every month against converged reference curves, by antenna number.

    The error of a month is the scatter of its path's events over the whole block divided by the root of their number:
    a month has too few events to know its own scatter.
    """
    rows = np.flatnonzero(np.isin(block.antennas, [a for a, curve in references.items() if curve.c is not None]))
    curves = [references[int(antenna)] for antenna in block.antennas[rows]]
    gain = event_gains(block, rows, curves, instrument, sky_power)
    is_present = block.is_present[rows]
    event_month = block.time_unix.astype("datetime64[s]").astype("datetime64[M]")
    months, month_of_event = np.unique(event_month, return_inverse=True)
    in_month = (month_of_event[:, None] == np.arange(months.size)).astype(float)

    events = is_present.astype(float) @ in_month
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(is_present, gain, 0.0) @ in_month / events
        spread = np.where(is_present, (gain - mean[:, month_of_event]) ** 2, 0.0).sum(axis=1)
        scatter = np.sqrt(spread / np.maximum(is_present.sum(axis=1) - months.size, 1))
        sigma = scatter[:, None] / np.sqrt(events)
        is_good = (events >= MIN_EVENTS) & (mean > 0)
        c_ratio = np.where(is_good, mean**-0.5, np.nan)
        c_ratio_sigma = np.where(is_good, 0.5 * sigma * mean**-1.5, np.nan)
    return MonthlyRatios(block.antennas[rows], months, c_ratio, c_ratio_sigma, events.astype(np.int64))


def event_gains(
    block: SpectraBlock,
    rows: NDArray[np.int64],
    curves: list[CalibrationCurve],
    instrument: Instrument,
    sky_power: SkyPower,
) -> Floats:
    """The gain g of every event against fixed curves, shape (antenna, event); any number where nothing was measured.

    Channels are weighted by (S / P)^2: where half of the power is receiver noise, a gain shows half as much over the
    same relative noise.
    """
    sky = sky_power.at(block.dipole, local_sidereal_time(block.time_unix, instrument.longitude_deg))
    gains = np.empty((rows.size, block.time_unix.size))
    for k, (row, curve) in enumerate(zip(rows, curves, strict=True)):
        if curve.c is None:
            raise ValueError(f"{curve.name} has no values to compare with")
        level = {name: parameter.value for name, parameter in curve.parameters.items()}
        at = curve.has_value
        signal = (sky[:, at] + level["n_lna"]) * (instrument.antenna_gain / curve.c**2)[at]
        behind = level["n_rcu"] * instrument.receiver_gain[at] + level["n_adc"]
        weight = (signal / (signal + behind)) ** 2
        gains[k] = np.sum(weight * (block.power[row][:, at] - behind) / signal, axis=1) / np.sum(weight, axis=1)
    return gains
