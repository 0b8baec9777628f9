from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from lbacal_core.traces.density import (
    bin_weights,
    channel_frequencies,
    effective_channels,
    hann,
    line_response,
    power_density,
    transform_blocks,
)

RATE = 200e6
WIDTH_MHZ = 200.0 / 1024


def test_sum_over_the_band_is_the_mean_square_of_the_windowed_samples_exactly() -> None:
    blocks = np.random.default_rng(4).normal(scale=20, size=(300, 1024)).astype(np.int16)
    density = power_density(blocks, RATE)
    window = hann(1024).astype(float)
    expected = np.mean(np.sum((blocks * window) ** 2, axis=1)) / np.sum(window**2)
    assert density.sum() * WIDTH_MHZ == pytest.approx(expected, rel=3e-6)  # single precision
    # The window weighs samples, so the mean square of all samples is met within its statistics: 1/sqrt(n/2 x 18/35).
    assert density.sum() * WIDTH_MHZ == pytest.approx(np.mean(blocks.astype(float) ** 2), rel=4 / np.sqrt(300 * 263))


def test_density_equals_a_plain_double_precision_transform() -> None:
    blocks = np.random.default_rng(5).integers(-2000, 2000, size=(7, 2048)).astype(np.int16)
    time = np.arange(2048)
    wave = np.exp(-2j * np.pi * np.outer(time, np.arange(1025)) / 2048)
    window = np.sin(np.pi * time / 2048) ** 2
    power = np.mean(np.abs((blocks * window) @ wave) ** 2, axis=0) * 2 / (200.0 * np.sum(window**2))
    power[[0, -1]] /= 2
    assert np.allclose(power_density(blocks, RATE), power, rtol=2e-5)


def test_density_is_that_of_welch_in_scipy() -> None:
    blocks = np.random.default_rng(15).integers(-2000, 2000, size=(40, 1024)).astype(np.int16)
    frequency_hz, density = welch(blocks.ravel().astype(float), RATE, nperseg=1024, noverlap=0, detrend=False)
    assert np.allclose(channel_frequencies(1024, RATE), frequency_hz / 1e6)
    assert np.allclose(power_density(blocks, RATE), density * 1e6, rtol=2e-5)  # single precision


def test_a_line_shows_its_power_once_and_in_the_shape_of_the_window() -> None:
    time = np.arange(64 * 1024) / RATE
    for offset in (0.0, 0.3, 0.5):
        frequency = (300 + offset) * RATE / 1024
        samples = np.rint(1500 * np.cos(2 * np.pi * frequency * time + 0.4)).astype(np.int16).reshape(-1, 1024)
        density = power_density(samples, RATE) * WIDTH_MHZ
        assert density.sum() == pytest.approx(1500**2 / 2, rel=1e-3)
        near = np.arange(295, 306)
        share = line_response(near - 300 - offset)
        assert np.allclose(density[near] / density.sum(), share, atol=2e-4)
    assert line_response(np.arange(-50.0, 51.0)).sum() == pytest.approx(1.0, abs=1e-9)
    assert line_response(np.array([1.0 - 1e-5]))[0] == pytest.approx(1 / 6, rel=1e-3)


def test_noise_of_neighbouring_channels_correlates_as_the_window_says() -> None:
    blocks = np.random.default_rng(6).normal(scale=30, size=(20_000, 256)).astype(np.int16)
    power = np.abs(transform_blocks(blocks)[:, 20:100]) ** 2
    power /= power.mean(axis=0)
    for apart, expected in ((1, 4 / 9), (2, 1 / 36), (3, 0.0)):
        found = np.mean((power[:, apart:] - 1) * (power[:, :-apart] - 1))
        assert found == pytest.approx(expected, abs=0.01)  # 20,000 x 80 products, correlated: 0.002


def test_every_bin_holds_5_12_channels_centred_on_it() -> None:
    channels = channel_frequencies(1024, RATE)
    bins = np.arange(30.0, 81.0)
    weights = bin_weights(channels, bins, 1.0)
    assert np.allclose(weights.sum(axis=1), 5.12)
    assert np.allclose(weights @ channels / 5.12, bins, atol=0.01)  # whole channels would be up to 0.1 MHz off


def test_effective_channels_of_a_bin_and_of_one_channel() -> None:
    weights = np.zeros((2, 50))
    weights[0, 7] = 1.0
    weights[1, 10:40] = 1.0
    single, many = effective_channels(weights)
    assert single == pytest.approx(1.0)
    assert many == pytest.approx(30 / (1 + 2 * (29 * 4 / 9 + 28 / 36) / 30), rel=1e-9)
    assert effective_channels(np.zeros(5)) == 0.0
