from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.sky import sky_ratios
from lbacal_core.skypower.model import vary_sky_power

LST = np.arange(32) * 0.75
OPTION = {
    "dipole_azimuth": "azimuth_deg",
    "zenith_weighting": "zenith_exponent",
    "pattern_width": "zenith_gain_fraction",
}
BETWEEN = [
    # A Fourier series of 8 angles: the beam has nothing above six times the azimuth.
    ("dipole_azimuth", 33.0, 1e-6),
    ("dipole_azimuth", -2.0, 1e-6),
    # A polynomial through four powers; the effect itself is 20 %.
    ("zenith_weighting", 0.8, 1e-4),
    ("zenith_weighting", 0.02, 2e-6),
    # Linear in its size.
    ("pattern_width", 0.3, 1e-6),
    ("pattern_width", -0.1, 1e-6),
]


@pytest.fixture(scope="module")
def ratios(world):
    return {name: ratio.at("XY", LST) for name, ratio in sky_ratios(world.instrument).items()}


def relative(power):
    """Shape (dipole, lst, freq) over its mean over LST."""
    return power / power.mean(axis=1, keepdims=True)


@pytest.fixture(scope="module")
def own(world):
    return vary_sky_power(world.instrument, lst_hours=LST)


@pytest.mark.parametrize(("name", "size", "tolerance"), BETWEEN)
def test_between_the_sizes_computed_the_ratio_is_the_exact_one(name, size, tolerance, ratios, own, world):
    exact = vary_sky_power(world.instrument, lst_hours=LST, **{OPTION[name]: size})
    expected = np.stack([exact.power[d] / own.power[d] for d in "XY"])
    sky = np.stack([own.power[d] for d in "XY"])
    assert relative(sky * ratios[name](np.array(size))) == pytest.approx(relative(sky * expected), rel=tolerance)


def test_a_power_of_the_cosine_is_taken_out_by_the_inverse(ratios):
    ratio = ratios["zenith_weighting"]
    np.testing.assert_allclose(ratio(np.array(-0.8)) * ratio(np.array(0.8)), 1.0, rtol=1e-12)


def test_every_event_may_have_an_amount_of_its_own(ratios):
    amounts = np.linspace(-0.3, 0.3, LST.size)
    for name, ratio in ratios.items():
        scale = 30.0 if name == "dipole_azimuth" else 1.0
        together = ratio(scale * amounts[:, None])
        apart = np.stack([ratio(np.array(scale * a))[:, k] for k, a in enumerate(amounts)], axis=1)
        np.testing.assert_allclose(together, apart, rtol=1e-12)


def test_no_size_is_no_change(ratios):
    for ratio in ratios.values():
        np.testing.assert_allclose(ratio(np.array(0.0)) * np.ones((2, 32, 51)), 1.0, rtol=1e-12)


def test_a_source_adds_its_share(ratios):
    for source in ("Cas A", "Cyg A", "Tau A", "Vir A"):
        share = ratios[source](np.array(1.0)) - 1.0
        assert np.all(share >= -1e-12)
        assert 1e-4 < share.max() < 0.5


def test_channels_that_the_own_models_do_not_cover_have_no_ratios(world):
    outside = replace(world.instrument, frequency_mhz=world.instrument.frequency_mhz + 300.0)
    assert sky_ratios(outside) == {}
