from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.neighbours import FEWEST_PAIRS, Neighbours
from lbacal_core.discovery.single_events import WITHIN_S, chance_of, find_memory

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


def test_what_is_taken_out_along_the_axes_costs_no_memory(in_runs):
    """It makes neighbours unlike, so that not one largest eigenvalue of 97 clean worlds came to the edge of noise."""
    p = np.array([find_memory(in_runs, noise_of(in_runs, seed), FLAT, SMOOTH).p_value for seed in range(200, 400)])
    # One in six largest eigenvalues of drawn matrices lies beyond the edge: 33 of 200, standard deviation 5.
    assert 18 <= np.sum(p < 1.0) <= 50
    assert np.sum(p < 0.05) <= 20


def test_cumulants_of_neighbours_are_those_of_the_whole_matrix(in_runs):
    time, profiles = np.sort(in_runs.conditions.time_unix), in_runs.profiles_of_axes
    pairs = (np.abs(time[:, None] - time) < WITHIN_S) / 2.0 - np.eye(time.size) / 2.0
    rest = np.eye(time.size) - profiles @ profiles.T
    whole = rest @ pairs @ rest
    mean, variance, skewness = Neighbours.of(time, WITHIN_S).cumulants(profiles)
    assert mean == pytest.approx(np.trace(whole))
    assert variance == pytest.approx(2.0 * (np.sum(whole**2) - np.trace(whole) ** 2 / np.trace(rest)))
    assert skewness == pytest.approx(8.0 * np.trace(whole @ whole @ whole) / variance**1.5)
    amounts = np.random.default_rng(8).standard_normal((time.size, 2000))
    amounts -= profiles @ (profiles.T @ amounts)
    amounts *= np.sqrt(np.trace(rest) / np.sum(amounts**2, axis=0))
    drawn = np.sum(amounts * Neighbours.of(time, WITHIN_S).next_to(amounts), axis=0)
    # 2,000 draws know the mean to 0.02 standard deviations and these to 1.6 %.
    assert np.mean(drawn) == pytest.approx(mean, abs=0.1 * variance**0.5)
    assert np.std(drawn) == pytest.approx(variance**0.5, rel=0.08)


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
