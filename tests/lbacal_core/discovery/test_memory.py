from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.memory import FEWEST_PAIRS, chance_of, find_memory

CHANNELS = 51
FLAT = np.full((1, CHANNELS), CHANNELS**-0.5)
SMOOTH = np.polynomial.legendre.legvander(np.linspace(-1, 1, CHANNELS), 5).T


@pytest.fixture(scope="module")
def in_runs(station):
    """The station with its events in runs: one every hour and a half for seven to eight hours, in days far apart."""
    events = station.conditions.time_unix.size
    time = (
        station.conditions.time_unix[0] + 86_400.0 * 6.1 * (np.arange(events) // 6) + 5400.0 * (np.arange(events) % 6)
    )
    return replace(station, conditions=replace(station.conditions, time_unix=time))


def noise_of(station, seed):
    return np.random.default_rng(seed).standard_normal((station.conditions.time_unix.size, CHANNELS))


def test_bursts_that_last_for_hours_are_seen(in_runs):
    """Jupiter below 38 MHz was `consistent` in four of four worlds, and made a vector of the noise of its own."""
    spectrum = 1.0 / (1.0 + np.exp((np.linspace(30, 80, CHANNELS) - 38.0) / 1.5))
    is_bursting = np.repeat(np.random.default_rng(6).random(50) < 0.2, 6)
    white = noise_of(in_runs, 1) + 1.4 * np.outer(is_bursting, spectrum)
    found = find_memory(in_runs, white, FLAT, SMOOTH)
    assert found.p_value < 1e-4
    assert found.spectrum @ spectrum / np.linalg.norm(spectrum) > 0.8
    # The same bursts in events that are no neighbours are no memory.
    mixed = white[np.random.default_rng(2).permutation(len(white))]
    assert find_memory(in_runs, mixed, FLAT, SMOOTH).p_value > 0.01


def test_noise_has_no_memory(in_runs):
    p = np.array([find_memory(in_runs, noise_of(in_runs, seed), FLAT, SMOOTH).p_value for seed in range(60)])
    assert p.min() > 1e-3
    assert np.mean(p == 1.0) > 0.5


def test_what_follows_an_axis_is_no_memory(in_runs):
    wave = np.cos(2 * np.pi * in_runs.conditions.utc_hours / 24.0)
    assert find_memory(in_runs, noise_of(in_runs, 3) + np.outer(wave, FLAT), FLAT, SMOOTH).p_value > 0.01


def test_events_that_are_far_apart_are_not_asked(station):
    """300 events of a year have few neighbours: the products of so few pairs are not normal."""
    time = np.sort(station.conditions.time_unix)
    assert np.sum(np.diff(time) < 3 * 3600.0) < FEWEST_PAIRS
    assert find_memory(station, noise_of(station, 4), FLAT, SMOOTH) is None


@pytest.mark.parametrize("size", [4, 8])
def test_the_probability_of_the_largest_eigenvalue_is_that_of_drawn_matrices(size):
    """The law of Tracy and Widom, for large matrices, made it up to eight times as large."""
    drawn = np.random.default_rng(5).standard_normal((40_000, size, size))
    largest = np.linalg.eigvalsh((drawn + drawn.transpose(0, 2, 1)) / 2)[:, -1]
    for share in (0.01, 0.001):
        chance = chance_of(float(np.quantile(largest, 1 - share)), size)
        # 40 of 40,000 beyond the smallest share: 16 %.
        assert chance == pytest.approx(share, rel=0.4)
