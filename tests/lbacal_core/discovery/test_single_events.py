from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import legvander

from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.residual_structure import find_structure
from lbacal_core.discovery.single_events import (
    _chance_together,
    _largest_of_noise,
    find_in_events,
    share_of_channels,
)
from tests.lbacal_core.discovery.worlds import Look, look_with_residual

SIGNIFICANT = 0.002


def test_the_spectrum_of_a_vector_is_where_it_is_not_flat(model):
    line = np.zeros_like(model.residuals.mean)
    line[:, ::2, 20] = 1.0
    share = share_of_channels(model, line)
    assert np.argmax(share) == 20
    assert share[20] > 0.9
    assert share.sum() == pytest.approx(1.0)


@pytest.mark.long
def test_single_events_of_noise_show_no_more_than_noise(look):
    """Compared at the same total: a level that is wrong by 2 % would look like half a standard deviation."""
    rng = np.random.default_rng(2)
    gains, sizes = [], []
    smooth = legvander(np.linspace(-1, 1, look.data.power.shape[2]), 5).T
    for seed in range(120):
        noise = 0.044 * rng.standard_normal(look.data.power.shape)
        found = find_in_events(look_with_residual(look, noise).model.linear, smooth, np.random.default_rng(seed))
        gains.append(found.gain)
        sizes.append(_largest_of_noise(rng, *look.data.power.shape[1:]))
    # 120 draws know the mean to 0.1 standard deviations.
    assert np.mean(gains) == pytest.approx(0.0, abs=0.3 * np.std(sizes))


def test_structure_in_single_events_is_found_without_an_axis(look):
    events = np.zeros(look.data.power.shape[1])
    events[[20, 50, 90, 130]] = 0.08
    shown = np.outer(events, np.cos(9 * np.linspace(-1, 1, look.data.power.shape[2])))
    found = look_with_residual(look, look.model.baseline.residual + shown).residual_structure(alpha=SIGNIFICANT)
    assert (found.axis_name, found.target) == ("event", "station")


def test_bursts_on_one_side_of_zero_are_seen_although_none_stands_out(station, model):
    """Jupiter adds one or two standard deviations to a fifth of the events, along a vector that their noise has."""
    rng = np.random.default_rng(12)
    events, vectors = station.power.shape[1], model.residuals.seeds.mean(axis=0)
    noise = 0.02 * rng.standard_normal((events, 1)) * vectors[1]
    burst = 0.08 * (rng.random((events, 1)) < 0.2) * vectors[1]
    own = 0.044 * rng.standard_normal(station.power.shape)
    look = Look(station, fit_chain(station), None)
    for added, is_left in ((noise, False), (noise + burst, True)):
        linear = look_with_residual(look, own + added).model.linear
        found = find_structure(linear, np.random.default_rng(1), SIGNIFICANT)
        assert (found is not None) == is_left
        assert found is None or (found.axis_name, found.target) == ("event", "station")


def test_lines_of_interference_in_a_few_events_are_no_structure(station):
    """Lines that were left in one event of 25, some of them in one channel, made a clean station "unexplained"."""
    rng = np.random.default_rng(14)
    noise = 0.044 * rng.standard_normal(station.power.shape)
    line = np.zeros(station.power.shape[1:])
    line[rng.choice(len(line), 12, replace=False), [11, 11, 11, 11, *rng.choice(51, 8)]] = 0.4
    look = Look(station, fit_chain(station), None)
    linear = look_with_residual(look, noise + line).model.linear
    assert find_structure(linear, np.random.default_rng(1), SIGNIFICANT) is None


def test_a_vector_of_the_noise_that_is_off_by_a_few_per_cent_is_no_structure(station, model):
    """The fitted slope of a resonance is off by some per cent: what lies beside it goes with its amounts."""
    rng = np.random.default_rng(15)
    vector = model.residuals.seeds.mean(axis=0)[2]
    beside = 0.07 * np.linalg.norm(vector) * np.cos(9 * np.linspace(-1, 1, vector.size)) / (vector.size / 2) ** 0.5
    amounts = 0.11 * rng.standard_normal((station.power.shape[1], 1))
    own = 0.044 * rng.standard_normal(station.power.shape)
    look = Look(station, fit_chain(station), None)
    linear = look_with_residual(look, own + amounts * (vector + beside)).model.linear
    assert find_structure(linear, np.random.default_rng(1), SIGNIFICANT) is None


@pytest.mark.long
def test_tests_of_which_each_sees_a_little_see_structure_together():
    """Storms were on one side with 4 in 10,000 and alike in neighbours with 3 in 100,000, yet `consistent`."""
    assert _chance_together([0.84, 7e-4, 3.4e-5]) < 1e-5
    assert _chance_together([0.5, 0.9, 1e-6]) < 1e-5
    assert _chance_together([0.5, 0.9, 1.0]) > 0.9
    drawn = np.random.default_rng(3).random((40_000, 3))
    together = np.array([_chance_together(chances) for chances in drawn])
    for share in (0.1, 0.01, 0.001):
        # Both tests agree where one of three is rare: no more than asked, and not much less. 40 of 40,000: 16 %.
        assert 0.5 * share < np.mean(together < share) < 1.3 * share
