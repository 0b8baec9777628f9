from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.directions import relative_sky_changes
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.variation import vary_sky_power


def test_changes_of_the_sky_are_the_logarithm_of_with_over_without(world):
    """To first order: a large turn against the tabulated change a degree times its angle."""
    changes = relative_sky_changes(world.instrument)
    own = compute_sky_power(world.instrument)
    for name, option, amount in (
        ("dipole_azimuth", "azimuth_deg", 2.0),
        ("zenith_weighting", "zenith_exponent", 0.2),
        ("pattern_width", "zenith_gain_fraction", 0.1),
    ):
        with_it = vary_sky_power(world.instrument, **{option: amount})
        without = vary_sky_power(world.instrument, **{option: 0.0})
        assert without.power["X"] == pytest.approx(own.power["X"], rel=1e-3)
        for dipole in "XY":
            expected = np.log(with_it.power[dipole] / without.power[dipole])
            found = amount * np.log(changes[name].power[dipole])
            assert np.linalg.norm(found - expected) < 0.06 * np.linalg.norm(expected), name
    for source in ("Cas A", "Cyg A", "Tau A", "Vir A"):
        share = np.log(changes[source].power["X"])
        assert np.all(share >= -1e-12)
        assert 1e-4 < share.max() < 0.5


def test_channels_that_the_own_models_do_not_cover_have_no_changes_of_the_sky(world):
    outside = replace(world.instrument, frequency_mhz=world.instrument.frequency_mhz + 300.0)
    assert relative_sky_changes(outside) == {}
