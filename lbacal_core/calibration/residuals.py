"""What a fitted curve predicts, term by term, and what the spectra leave beside it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra_blocks import SpectraBlock


def noise_at_input(curve: CalibrationCurve, instrument: Instrument) -> dict[str, Floats]:
    """The noise terms of a fitted curve referred to the start of the chain (Fig. 5 of the paper).

    Each constant divided by what amplifies the sky up to the point where it was fitted: N_RCU S G_RCU and N_ADC by
    G_ant / C^2.

    Returns
    -------
    `lna`, `rcu` and `adc`, each shape (freq,), in the unit of P_sky.
    """
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    slope = instrument.antenna_gain / curve.c**2
    return {
        "lna": np.full_like(slope, curve.parameters["n_lna"].value),
        "rcu": curve.parameters["n_rcu"].value * instrument.receiver_gain / slope,
        "adc": curve.parameters["n_adc"].value / slope,
    }


def predict_power(curve: CalibrationCurve, instrument: Instrument, sky: Floats) -> Floats:
    """Recorded power of a fitted path for a sky power of shape (event, freq)."""
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    return np.asarray((sky + sum(noise_at_input(curve, instrument).values())) * instrument.antenna_gain / curve.c**2)


def map_residuals(
    block: SpectraBlock,
    curves: Iterable[CalibrationCurve],
    instrument: Instrument,
    sky_power: SkyPower,
    lst_bins: int = 48,
) -> Floats:
    """Measured over predicted power minus 1, averaged over a station's antennas and the events of each LST bin.

    Returns
    -------
    Shape (lst_bins, freq); NaN in a bin without events.
    """
    of_antenna = {
        curve.antenna: curve
        for curve in curves
        if curve.c is not None and (curve.station, curve.dipole) == (block.station, block.dipole)
    }
    lst_hours = local_sidereal_time(block.time_unix, instrument.longitude_deg)
    sky = sky_power.at(block.dipole, lst_hours)
    bins = np.minimum((lst_hours / 24.0 * lst_bins).astype(int), lst_bins - 1)
    total = np.zeros((lst_bins, instrument.frequency_mhz.size))
    count = np.zeros((lst_bins, 1))
    for row, antenna in enumerate(block.antennas):
        if int(antenna) not in of_antenna:
            continue
        is_present = block.is_present[row]
        predicted = predict_power(of_antenna[int(antenna)], instrument, sky[is_present])
        np.add.at(total, bins[is_present], block.power[row, is_present] / predicted - 1.0)
        np.add.at(count, bins[is_present], 1.0)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)
