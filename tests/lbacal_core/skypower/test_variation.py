from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power, vary_sky_power

INSTRUMENT = load_instrument("lofar-superterp")


def test_no_variation_is_the_plain_sky_power() -> None:
    plain = compute_sky_power(INSTRUMENT)
    assert vary_sky_power(INSTRUMENT).power["Y"] == pytest.approx(plain.power["Y"], rel=1e-12)


def test_turned_arms_are_another_instrument() -> None:
    arms = {name: azimuth + 10.0 for name, azimuth in INSTRUMENT.dipole_azimuth_deg.items()}
    turned = compute_sky_power(replace(INSTRUMENT, dipole_azimuth_deg=arms))
    assert vary_sky_power(INSTRUMENT, azimuth_deg=10.0).power["X"] == pytest.approx(turned.power["X"], rel=1e-9)


def test_ten_percent_of_zenith_gain_at_fixed_total_changes_the_power_by_a_few_percent() -> None:
    # The paper propagates this variation to 2.5 % in power; a uniform sky would not change at all.
    plain, varied = compute_sky_power(INSTRUMENT), vary_sky_power(INSTRUMENT, zenith_gain_fraction=0.1)
    change = np.abs(varied.power["X"] / plain.power["X"] - 1)
    assert 0.005 < change.max() < 0.06
    assert change.mean() < 0.03
