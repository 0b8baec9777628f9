"""A window too small for a fit borrows from its neighbour: the neighbour's curve, the step as one free gain.

Between the two the hardware changed. What is known of that, the losses of the cables, is applied; everything else is
put down to a gain in front of N_RCU, free, the mean of the window's own events (`lbacal_core.drift.events`). So the
noise constants and the shape of C(nu) are the neighbour's, and its error is the neighbour's beside that of the gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.covariance import CurveCovariance, compress_covariance
from lbacal_core.curves import CONVERGED, CalibrationCurve
from lbacal_core.drift.events import measure_event_modes
from lbacal_core.instrument import Instrument
from lbacal_core.screening import screen_block
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock

FEWEST_EVENTS = 5
"""Fewer know the gain no better than 2.5 %."""


@dataclass(frozen=True)
class Borrowed:
    """A curve made from a neighbour's.

    Attributes
    ----------
    gain, sigma
        Factor on C beside what the cables explain, and its standard deviation.
    events
        How many of its own it has.
    """

    curve: CalibrationCurve
    gain: float
    sigma: float
    events: int


def borrow_curve(
    neighbour: CalibrationCurve,
    block: SpectraBlock,
    instrument: Instrument,
    sky_power: SkyPower,
    cables: tuple[str, str],
) -> Borrowed | None:
    """Make the curve of a path from that of its neighbour window; None where it has too few events for one gain.

    Parameters
    ----------
    neighbour
        A curve with values, of the same path.
    block
        The path's own spectra.
    cables
        Names of the cables in the neighbour's window and in its own.
    """
    if neighbour.c is None or neighbour.antenna is None or neighbour.c_sigma_stat is None:
        raise ValueError(f"{neighbour.name} has no values to borrow")
    before, now = (instrument.cables[name] for name in cables)
    through = neighbour.c * np.sqrt(before / now)
    block = screen_block(block, instrument.at_station(block.station).longitude_deg).block
    modes = measure_event_modes(block, {neighbour.antenna: replace(neighbour, c=through)}, instrument, sky_power)
    known = modes.ln_c[0, :, 0][np.isfinite(modes.ln_c[0, :, 0])]
    if known.size < FEWEST_EVENTS:
        return None
    gain, sigma = float(np.exp(known.mean())), float(known.std(ddof=1) / known.size**0.5)
    c = through * gain
    curve = replace(
        neighbour,
        status=CONVERGED,
        events=int(known.size),
        c=c,
        c_sigma_stat=c * np.hypot(neighbour.c_sigma_stat / neighbour.c, sigma),
        c_sigma_sys=None if neighbour.c_sigma_sys is None else neighbour.c_sigma_sys * c / neighbour.c,
        covariance=None if neighbour.covariance is None else _with_gain(neighbour.covariance, sigma),
    )
    return Borrowed(curve, gain, sigma, int(known.size))


def _with_gain(covariance: CurveCovariance, sigma: float) -> CurveCovariance:
    """The covariance with the error of a gain that all channels share."""
    matrix = covariance.factor.T @ covariance.factor + np.diag(covariance.diagonal) + sigma**2
    factor, diagonal = compress_covariance(matrix)
    return replace(covariance, factor=factor, diagonal=diagonal)
