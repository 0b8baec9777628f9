from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument import load_instrument
from lbacal_core.sky.sources import SOURCES
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.power import power_per_kelvin_sr
from lbacal_core.skypower.variation import point_source_power, source_sky_power, vary_sky_power

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


def test_a_point_source_is_a_very_small_piece_of_sky() -> None:
    nu = np.array([55.0])
    wavelength = 299.792458 / nu
    # 1 K over 1e-4 sr has the flux 2 k T dOmega / lambda^2.
    flux_jy = 2 * 1.380649e-23 * 1e-4 / wavelength**2 / 1e-26
    assert point_source_power(flux_jy, np.ones((1, 1)))[0] == pytest.approx(1e-4 * power_per_kelvin_sr(nu), rel=1e-9)


def test_cassiopeia_a_is_a_percent_of_the_sky_and_cygnus_a_culminates_at_its_right_ascension() -> None:
    lst = np.arange(96) / 4
    plain = compute_sky_power(INSTRUMENT)
    cas = source_sky_power(INSTRUMENT, SOURCES["cas-a"], "X", lst)
    cyg = source_sky_power(INSTRUMENT, SOURCES["cyg-a"], "X", lst)
    assert 0.001 < (cas / plain.power["X"]).max() < 0.05
    assert np.all(cas > 0)  # circumpolar
    assert lst[cyg[:, 25].argmax()] == pytest.approx(299.868 / 15, abs=1.0)
