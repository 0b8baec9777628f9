from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.causes.catalogue import DESCRIPTIONS
from lbacal_core.discovery.curve_fit import GRID_HOURS, gather_curve, list_choices, why_not
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights, noise_prior
from lbacal_core.skypower.model import vary_sky_power

BAND = (30.0, 80.0)


@pytest.fixture(scope="module")
def station(chain, sky):
    weights = band_weights(chain, AS_RECORDED, BAND)
    return gather_curve(chain, sky, weights, noise_prior(chain, BAND, weights))


@pytest.fixture(scope="module")
def choices(station):
    return {choice.label: choice for choice in list_choices(station)}


@pytest.fixture(scope="module")
def with_causes(station, choices):
    """Recorded power without noise and with causes at sizes, shape (dipole, lst, freq)."""

    def make(**sizes):
        named = [choices[label.replace("_near_90", " 90 deg")] for label in sizes]
        return station.terms_with(named, np.array(list(sizes.values())), 0.0).power()

    return make


def relative(power):
    """Every dipole's power over its mean over LST."""
    return power / power.mean(axis=1, keepdims=True)


def test_the_band_power_is_that_of_the_sky_weighed_with_the_channels(station, sky, chain):
    weights = band_weights(chain, AS_RECORDED, BAND)
    expected = np.stack([sky.at(d, GRID_HOURS) @ weights for d in "XY"])
    quiet = station.terms_with([], np.zeros(0), 0.0).power().sum(axis=-1)
    np.testing.assert_allclose(quiet, expected, rtol=1e-12)
    # The noise is the same in both polarisations, and 0.5 of their mean sky.
    noisy = station.terms_with([], np.zeros(0), 0.5).power().sum(axis=-1)
    np.testing.assert_allclose(noisy - quiet, 0.5 * expected.mean(), rtol=1e-12)


def test_no_cause_of_size_zero_changes_anything(station, choices):
    for choice in choices.values():
        unchanged = station.terms_with([choice], np.zeros(1), 1.0).power()
        np.testing.assert_allclose(unchanged, station.terms.power(), rtol=1e-9)


def test_a_turn_by_a_right_angle_exchanges_the_dipoles(with_causes):
    turned, exchanged = with_causes(dipole_azimuth_near_90=90.0), with_causes(dipole_swap=1.0)
    assert relative(turned) == pytest.approx(relative(exchanged), rel=1e-6)


def test_an_exchange_carries_the_beam_of_the_other_dipole_with_it(with_causes):
    both = with_causes(zenith_weighting=0.5, dipole_swap=1.0)
    np.testing.assert_allclose(both, with_causes(zenith_weighting=0.5)[::-1], rtol=1e-12)


def test_a_shift_moves_the_power_as_all_causes_have_made_it(with_causes):
    step = float(GRID_HOURS[1])
    before = with_causes(zenith_weighting=0.5, dipole_swap=0.7)
    moved = with_causes(zenith_weighting=0.5, dipole_swap=0.7, lst_offset=step)
    np.testing.assert_allclose(moved, np.roll(before, -1, axis=1), rtol=1e-9)


def test_a_power_of_the_cosine_is_the_exact_one(with_causes, chain, station):
    exact = vary_sky_power(chain, zenith_exponent=0.7)
    expected = np.stack([exact.at(d, GRID_HOURS) for d in "XY"]) * station.weights
    assert relative(with_causes(zenith_weighting=0.7)) == pytest.approx(relative(expected), rel=1e-4)


def test_a_power_too_many_in_the_simulation_is_taken_out_exactly(chain, choices):
    """own(0)/own(1) at -1; own(-1)/own(0), which is not the inverse, needed -0.77 for a whole cosine too many."""
    weights = band_weights(chain, AS_RECORDED, BAND)
    wrong = vary_sky_power(chain, zenith_exponent=1.0)
    station = gather_curve(chain, wrong, weights, noise_prior(chain, BAND, weights))
    found = station.terms_with([choices["zenith_weighting"]], np.array([-1.0]), 0.0).power()
    right = np.stack([vary_sky_power(chain).at(d, GRID_HOURS) for d in "XY"]) * weights
    assert relative(found) == pytest.approx(relative(right), rel=1e-4)


def test_noise_and_an_isotropic_level_flatten_a_channel_alike_and_are_never_fitted_together(with_causes, choices):
    noise, level = choices["missing_noise"], choices["isotropic_level"]
    assert noise.kinds == level.kinds
    assert noise.scale != 1.0
    plain = relative(with_causes()).std()
    assert relative(with_causes(isotropic_level=0.5)).std() == pytest.approx(plain / 1.5, rel=1e-6)
    flat = with_causes(missing_noise=0.5).sum(axis=-1)
    assert flat.mean() == pytest.approx(1.5 * with_causes().sum(axis=-1).mean(), rel=1e-12)


def test_a_turn_by_a_right_angle_is_an_alias_of_an_exchange(choices):
    turn = choices["dipole_azimuth 90 deg"]
    assert turn.is_alias
    assert turn.kinds > choices["dipole_swap"].kinds
    assert [choice.label for choice in choices.values() if choice.is_alias] == [turn.label]


def test_every_cause_of_the_catalogue_is_asked_or_has_a_reason_that_follows_from_its_axes(station, choices):
    reasons = why_not(station, list(choices.values()))
    asked = {choice.cause.identifier for choice in choices.values()}
    assert asked | set(reasons) == {one.identifier for one in DESCRIPTIONS}
    assert not asked & set(reasons)
    assert "date" in reasons["gain_drift"]
    assert "frequency" in reasons["cable_length"]
    assert "level" in reasons["adc_jitter"]
    assert "level" in reasons["lna_noise_slope"]
    assert "missing_noise" in asked


def test_channels_that_the_own_models_do_not_cover_leave_the_causes_that_need_no_direction(chain, sky, monkeypatch):
    monkeypatch.setattr("lbacal_core.discovery.curve_fit.sky_ratios", lambda _: {})
    weights = band_weights(chain, AS_RECORDED, BAND)
    station = gather_curve(chain, sky, weights, noise_prior(chain, BAND, weights))
    asked = {choice.label for choice in list_choices(station)}
    assert asked == {"dipole_swap", "lst_offset", "missing_noise", "isotropic_level", "compression"}
    assert "do not cover" in why_not(station, list_choices(station))["zenith_weighting"]
