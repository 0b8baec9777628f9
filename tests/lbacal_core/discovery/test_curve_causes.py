from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.curve_causes import NEEDS_MORE_AXES, curve_causes
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights
from lbacal_core.skypower.variation import vary_sky_power


@pytest.fixture(scope="module")
def causes(chain, sky):
    return {cause.label: cause for cause in curve_causes(chain, sky, band_weights(chain, AS_RECORDED, (30.0, 80.0)))}


def relative(power):
    """Every dipole's power over its mean over LST."""
    return np.array([power[d] / power[d].mean(axis=0) for d in "XY"])


def test_no_cause_of_size_zero_changes_anything(causes, sky):
    for cause in causes.values():
        changed = cause.act(sky.power, 0.0)
        for d in "XY":
            # 1e-9: an interpolation through 7 sizes
            assert changed[d] == pytest.approx(sky.power[d], rel=1e-9)


def test_a_turn_by_a_right_angle_exchanges_the_dipoles(causes, sky):
    turned = causes["dipole_azimuth 90 deg"].act(sky.power, 90.0)
    exchanged = causes["dipole_swap"].act(sky.power, 1.0)
    assert relative(turned) == pytest.approx(relative(exchanged), rel=1e-6)


def test_a_turn_between_the_angles_computed_is_the_exact_one(causes, chain, sky):
    exact = vary_sky_power(chain, azimuth_deg=33.0).power
    # 1e-6: a Fourier series of 8 angles; the beam has nothing above six times the azimuth
    assert relative(causes["dipole_azimuth"].act(sky.power, 33.0)) == pytest.approx(relative(exact), rel=1e-6)


def test_a_power_of_the_cosine_between_those_computed_is_the_exact_one(causes, chain, sky):
    exact = vary_sky_power(chain, zenith_exponent=-0.8).power
    # 2e-3: interpolated between powers half apart; the effect itself is 20 %
    assert relative(causes["zenith_weighting"].act(sky.power, -0.8)) == pytest.approx(relative(exact), rel=2e-3)


def test_a_wider_pattern_is_the_exact_one(causes, chain, sky):
    exact = vary_sky_power(chain, zenith_gain_fraction=0.3).power
    assert relative(causes["pattern_width"].act(sky.power, 0.3)) == pytest.approx(relative(exact), rel=1e-6)


def test_noise_and_an_isotropic_level_flatten_a_channel_alike(causes, sky):
    noise, level = causes["missing_noise"], causes["isotropic_level"]
    assert noise.kinds == level.kinds
    assert noise.reported != 1.0
    assert relative(level.act(sky.power, 0.5)).std() == pytest.approx(relative(sky.power).std() / 1.5, rel=1e-6)


def test_a_shift_moves_the_power_to_earlier_grid_points(causes, sky):
    step = sky.lst_hours[1]
    moved = causes["lst_offset"].act(sky.power, float(step))
    assert moved["X"] == pytest.approx(np.roll(sky.power["X"], -1, axis=0), rel=1e-9)


def test_only_the_end_of_what_is_believed_counts_as_an_edge(causes):
    assert causes["pattern_width"].is_at_edge(0.35)
    assert not causes["pattern_width"].is_at_edge(0.34)
    assert not causes["dipole_swap"].is_at_edge(1.0)


def test_every_cause_of_the_catalogue_is_asked_or_has_a_reason(causes):
    asked = {cause.identifier for cause in causes.values()}
    assert len(asked | set(NEEDS_MORE_AXES)) == 26
    assert not asked & set(NEEDS_MORE_AXES)
