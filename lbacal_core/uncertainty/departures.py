"""What events depart from the curve that answers for their path: its own, else that of its station or of the array."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from lbacal_core.calibration.residuals import predict_power
from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock

LST_BINS = 48


def compare_paths(
    block: SpectraBlock, curves: Iterable[CalibrationCurve], instrument: Instrument, sky_power: SkyPower
) -> Iterator[tuple[int, CalibrationCurve, Floats]]:
    """Measured over predicted power of every path of a block that a curve answers for.

    Returns
    -------
    The row of the path in the block, its curve, and the ratio, shape (event that the path has, freq).
    """
    known = {(curve.station, curve.antenna, curve.dipole): curve for curve in curves if curve.c is not None}
    lst_hours = local_sidereal_time(block.time_unix, instrument.at_station(block.station).longitude_deg)
    sky = sky_power.of_station(block.station).at(block.dipole, lst_hours)
    for row, antenna in enumerate(block.antennas.tolist()):
        owners = ((block.station, antenna), (block.station, None), (None, None))
        curve = next((known[(*owner, block.dipole)] for owner in owners if (*owner, block.dipole) in known), None)
        is_present = block.is_present[row]
        if curve is not None and np.any(is_present):
            yield row, curve, block.power[row, is_present] / predict_power(curve, instrument, sky[is_present])


def map_departures(
    block: SpectraBlock, curves: Iterable[CalibrationCurve], instrument: Instrument, sky_power: SkyPower
) -> Floats:
    """Measured over predicted power minus 1, the mean over a station's antennas and the events of each LST bin.

    A path without a curve of its own counts less its mean departure in each channel, which is its own gain.

    Returns
    -------
    Shape (LST_BINS, freq); NaN in a bin without events.
    """
    lst_hours = local_sidereal_time(block.time_unix, instrument.at_station(block.station).longitude_deg)
    bins = np.minimum((lst_hours / 24.0 * LST_BINS).astype(int), LST_BINS - 1)
    total = np.zeros((LST_BINS, block.frequency_mhz.size))
    count = np.zeros((LST_BINS, 1))
    for row, curve, ratio in compare_paths(block, curves, instrument, sky_power):
        own = ratio if curve.antenna is not None else ratio / ratio.mean(axis=0)
        at = bins[block.is_present[row]]
        np.add.at(total, at, own - 1.0)
        np.add.at(count, at, 1.0)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)
