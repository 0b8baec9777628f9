from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.sources import SOURCES, find_sources
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.power import power_per_kelvin_sr
from lbacal_core.skypower.sources import add_sources, point_source_power, source_sky_power

INSTRUMENT = load_instrument("lofar-superterp")


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


def test_sources_are_added_by_name() -> None:
    plain = compute_sky_power(INSTRUMENT)
    bright = add_sources(plain, INSTRUMENT, find_sources(["cas-a", "cyg-a"]), year=2012.0)
    expected = sum(
        source_sky_power(INSTRUMENT, SOURCES[name], "Y", plain.lst_hours, 2012.0) for name in ("cas-a", "cyg-a")
    )
    assert bright.power["Y"] - plain.power["Y"] == pytest.approx(expected)
    assert bright.origin.endswith("+ cas-a 2012 + cyg-a 2012")
