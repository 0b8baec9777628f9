from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.noise import split_residuals
from lbacal_core.discovery.project import LARGEST, EventGains


@pytest.fixture(scope="module")
def terms(station):
    return fit_baseline(station).terms


def test_a_resonance_moves_by_the_curve_that_was_fitted_not_by_that_of_the_instruments_table(station, terms):
    """A(nu) has structure: the table's slopes were off by a third, and what they left was an alarm."""
    nu = station.conditions.frequency_mhz
    structure = 0.1 * np.sin(2 * np.pi * nu / 9.0)
    plain, changed = (EventGains.of(station, replace(terms, front=terms.front * f)) for f in (1.0, np.exp(structure)))
    np.testing.assert_allclose(changed.slope - plain.slope, CubicSpline(nu, structure)(nu, 1), atol=1e-9)
    assert changed.vectors.shape == (len(station.conditions.dipoles), 3, nu.size)


@pytest.fixture(scope="module")
def moved(station, terms):
    """Gains, residuals of events whose resonance jitters by 0.4 MHz and their gain in front by 3 %, and the jitter."""
    rng = np.random.default_rng(12)
    nu, events = station.conditions.frequency_mhz, station.power.shape[1]
    resonance = -0.5 * ((nu - 55.0) / 6.0) ** 2
    conditions = station.conditions
    # a chain with a resonance of a known form
    flat = conditions.receiver_gain * np.exp(conditions.cable_log_loss[:, None, :])
    level = terms.front.mean() / flat.mean()
    gains = EventGains.of(station, replace(terms, front=level * flat * np.exp(resonance)))
    shift, gain = 0.4 * rng.standard_normal((events, 1)), 0.03 * rng.standard_normal((events, 1))
    of_events = -0.5 * ((nu - shift - 55.0) / 6.0) ** 2 - resonance
    change = gains.front * ((1.0 + gain) * np.exp(of_events) - 1.0)
    noise = 0.044 * rng.standard_normal(station.power.shape)
    return gains, change[station.class_of] + noise, shift[:, 0]


def test_what_a_resonance_that_moves_does_on_average_is_known_from_how_far_it_moves(station, moved):
    """A resonance that jitters in rain is wider on average, and was named as widening with rain."""
    gains, residual, shift = moved
    residuals = split_residuals(station, residual, gains.vectors)
    beyond = gains.beyond_first_order(station, residuals, residuals.mean)
    front = gains.front.mean(axis=0)
    truth = front * (gains.lower_by(-shift) + gains.slope * shift[:, None])
    template = front.mean(axis=0) * (gains.lower_by(np.array(0.4)) + gains.lower_by(np.array(-0.4)))
    of_beyond, of_truth = (values @ template for values in (beyond, truth))
    assert np.mean(of_beyond) == pytest.approx(np.mean(of_truth), rel=0.25)
    assert np.corrcoef(of_beyond, of_truth)[0, 1] > 0.7  # each event's shift is known to half of it


def test_a_burst_is_no_gain_however_strong_it_is(station, moved):
    gains, residual, _ = moved
    burst = residual.copy()
    burst[:, 7] += 3.0
    still, beyond = (
        gains.beyond_first_order(station, split, split.mean)[7]
        for split in (split_residuals(station, one, gains.vectors) for one in (residual, burst))
    )
    assert np.abs(beyond - still).max() < 0.01 * LARGEST


def test_a_shift_of_more_than_a_channel_is_known_where_the_curve_has_structure(station, terms):
    """One event of heavy rain moved by 1.3 MHz, and the resonance was named as following rain."""
    rng = np.random.default_rng(13)
    nu, events = station.conditions.frequency_mhz, station.power.shape[1]
    rough = replace(terms, front=terms.front * np.exp(0.01 * rng.standard_normal(nu.size)))
    gains = EventGains.of(station, rough)
    shift = 0.3 * rng.standard_normal(events)
    shift[7] = 1.3
    change = gains.front * gains.lower_by(-shift)
    residual = change[station.class_of] + 0.044 * rng.standard_normal(station.power.shape)
    residuals = split_residuals(station, residual, gains.vectors)
    beyond = gains.beyond_first_order(station, residuals, residuals.mean)[7]
    truth = (gains.front.mean(axis=0) * (gains.lower_by(-shift) + gains.slope * shift[:, None]))[7]
    assert np.std(beyond - truth) < 0.4 * np.std(truth)  # 0.8 after one round


def test_beyond_the_band_the_slopes_of_its_ends_continue(station, terms):
    gains = EventGains.of(station, terms)
    far = np.log1p(gains.lower_by(np.array([3.0, 6.0])))[:, -1]
    np.testing.assert_allclose(far, gains.slope[-1] * np.array([3.0, 6.0]))
