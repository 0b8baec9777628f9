"""How well a fit knows what an antenna records without the sky."""

from __future__ import annotations

import numpy as np

from lbacal_core.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower


def electronics_sigma(curve: CalibrationCurve, instrument: Instrument, sky_power: SkyPower) -> Floats:
    """Standard deviation of `calibration.antenna_noise.recorded_electronics`, shape (freq,), ADC^2/Ohm/MHz.

    The mean recorded power is known far better than its split: what the sky is given too much, the electronics get too
    little. With s = G_ant/C^2 the sky's part is s P_sky, and an error of ln C changes it by -2 s P_sky. A sky that is
    brighter than the model changes C and leaves s P_sky as it is.
    """
    if curve.c is None or curve.c_sigma_stat is None or curve.dipole is None:
        raise BadInputError(curve.name, "a curve of one polarisation with its statistical error", curve.status)
    slope, sky = instrument.antenna_gain / curve.c**2, sky_power.of_station(curve.station)
    return np.asarray(2.0 * curve.c_sigma_stat / curve.c * slope * sky.power[curve.dipole].mean(axis=0))
