from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.chain_test import free_own_sky
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.differences import LST_HOURS
from lbacal_core.skypower.model import compute_sky_power


@pytest.mark.parametrize("name", ["gsm408", "lfsm", "haslam", "maeda"])
def test_another_sky_is_about_one_standard_deviation_away(name):
    instrument = load_instrument("lofar-superterp")
    freedom, own = free_own_sky(instrument), compute_sky_power(instrument, lst_hours=LST_HOURS)
    other = compute_sky_power(instrument, sky=name, lst_hours=LST_HOURS)
    for dipole, modes in freedom.modes.items():
        change = np.log(other.power[dipole] / own.power[dipole]).ravel()
        flat = modes.reshape(len(modes), -1)
        # the most probable amplitudes for a change that is known to 0.3 %
        amplitude = np.linalg.solve(flat @ flat.T + 0.003**2 * np.eye(len(flat)), flat @ change)
        assert np.sum(amplitude**2) < 3.0
        assert np.sqrt(np.mean((change - amplitude @ flat) ** 2)) < 0.002


def test_the_digest_names_what_it_was_made_from():
    instrument = load_instrument("lofar-superterp")
    elsewhere = replace(instrument, latitude_deg=40.0)
    assert free_own_sky(instrument).digest == free_own_sky(instrument).digest
    assert free_own_sky(instrument).digest != free_own_sky(elsewhere).digest
