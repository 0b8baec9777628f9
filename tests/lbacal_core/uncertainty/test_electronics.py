from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.uncertainty.refit import electronics_sigma


def test_what_the_sky_is_given_too_much_the_electronics_get_too_little(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    slope = 2.0 * low_band.antenna_gain
    c = np.sqrt(low_band.antenna_gain / slope)
    frequency = low_band.frequency_mhz
    curve = CalibrationCurve("CS002", 0, "X", "converged", 900, frequency, c, 0.01 * c, None, 1.0, 1.0, {})
    # C is 1 % larger, so the sky's part is 2 % smaller, and the mean recorded power is as it was
    sky = two_waves.power["X"].mean(axis=0)
    assert electronics_sigma(curve, low_band, two_waves) == pytest.approx(0.02 * slope * sky)
    with pytest.raises(BadInputError, match="statistical"):
        electronics_sigma(replace(curve, c_sigma_stat=None), low_band, two_waves)
