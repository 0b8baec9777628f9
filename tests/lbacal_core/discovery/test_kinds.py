from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.cause import RAIN
from lbacal_core.discovery.noise import list_kinds, split_residuals
from tests.lbacal_core.discovery.vectors import THREE


def _levels(station, residual, rain):
    conditions = replace(station.conditions, covariates={**station.conditions.covariates, RAIN: 1.0 * rain})
    return split_residuals(replace(station, conditions=conditions), residual, THREE).levels


@pytest.mark.parametrize("spell", [5, 25])
def test_events_in_rain_have_levels_of_their_own(station, noise, spell):
    """A resonance that moves in rain alone was structure in single events, and once a cause that follows rain.

    Where fewer than 40 events were wet they were weighed as dry ones: interference and the Sun were named.
    """
    wet = np.arange(noise.shape[1]) % spell == 0
    moved = 0.6 * np.random.default_rng(9).standard_normal((1, noise.shape[1], 1)) * wet[:, None] * THREE[2]
    levels = _levels(station, noise + moved, wet)
    np.testing.assert_array_equal(levels.kind_of, wet)
    dry, rainy = (np.diag(levels.vectors.T @ one @ levels.vectors).max() for one in levels.common_sum)
    assert rainy > 4 * dry


def test_a_few_events_in_rain_are_weighed_as_the_others_where_they_are_alike_but_for_a_burst(station, noise):
    wet = np.arange(noise.shape[1]) % 25 == 0
    burst = noise + 2.0 * (np.arange(noise.shape[1]) == 50)[:, None] * THREE[2]
    for residual in (noise, burst):
        assert not np.any(_levels(station, residual, wet).kind_of)


@pytest.mark.parametrize("spell", [5, 20])
def test_a_resonance_that_moves_with_the_millimetres_of_rain_is_no_noise(station, noise, spell):
    """It made events in rain a kind of their own, whose noise took half of its score."""
    rng = np.random.default_rng(4)
    rain = np.where(np.arange(noise.shape[1]) % spell == 0, rng.exponential(1.5, noise.shape[1]), 0.0)
    moved = 0.2 * rain[:, None] * THREE[2]
    still, levels = (_levels(station, one, rain) for one in (noise, noise + moved))
    np.testing.assert_array_equal(levels.kind_of, still.kind_of)
    along = levels.vectors @ THREE[2] / np.linalg.norm(THREE[2])
    # what moves has a variance of 0.4 in rain, and the noise of the means none along this vector
    assert max(along @ one @ along for one in levels.common_sum) < 1e-3


def test_what_does_not_follow_rain_keeps_its_variance(station):
    """Three ways to follow rain describe a part of the noise of 60 events; the rest is scaled."""
    rng = np.random.default_rng(6)
    events = station.power.shape[1]
    rain = np.where(np.arange(events) % 5 == 0, rng.exponential(1.5, events), 0.0)
    conditions = replace(station.conditions, covariates={**station.conditions.covariates, RAIN: rain})
    amount = rng.standard_normal((400, events, 2))
    kinds = list_kinds(replace(station, conditions=conditions), amount[0])
    left = kinds.beside_rain(amount)
    np.testing.assert_array_equal(left[:, rain == 0], amount[:, rain == 0])
    assert np.mean(left[:, rain > 0] ** 2) == pytest.approx(1.0, abs=0.03)
    followed = amount + rain[:, None] * [2.0, -1.0] + np.tanh(rain)[:, None]
    np.testing.assert_allclose(kinds.beside_rain(followed), left, atol=1e-9)
