"""Noise in the time domain: what `lbacal spectra` measures in it is the spectrum that it was drawn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.traces.background import CleaningSettings, measure_traces
from lbacal_core.traces.noise import draw_noise
from lbacal_core.traces.trace import Trace

CHANNELS = np.arange(30.0, 81.0)
POWER = 4.0 * (CHANNELS / 55.0) ** -2.5 * (0.3 + np.exp(-0.5 * ((CHANNELS - 58.0) / 5.0) ** 2))


def test_spectra_of_traces_have_the_power_that_they_were_drawn_from(make_trace: Callable[..., Trace]) -> None:
    rng, like, found = np.random.default_rng(3), make_trace(1), []
    for noise in draw_noise(CHANNELS, np.tile(POWER, (12, 1)), like.samples.size, 200.0, rng):
        samples = np.rint(noise).astype(np.int16).reshape(like.samples.shape)
        (one,) = measure_traces([replace(like, samples=samples)], CleaningSettings(), is_station=False)
        assert one.excluded == ""
        found.append(one.power)
    # 2.9 % of a trace, by 12 of them, beside 0.3 % of a curved spectrum between the centres of channels;
    # rounding to whole ADC units adds 1/12 ADC^2 over 100 MHz
    expected = POWER + 1.0 / 12.0 / 100.0 / 50.0
    np.testing.assert_allclose(np.mean(found, axis=0)[1:-1], expected[1:-1], rtol=0.04)
    np.testing.assert_allclose(np.mean(np.divide(found, expected)[:, 1:-1]), 1.0, atol=0.005)


def test_the_mean_square_is_the_sum_over_channels_and_nothing_lies_outside() -> None:
    (noise,) = draw_noise(CHANNELS, POWER[None], 1 << 20, 200.0, np.random.default_rng(4))
    assert np.mean(noise**2) == pytest.approx(50.0 * POWER.sum(), rel=0.01)
    spectrum, bins = np.abs(np.fft.rfft(noise)) ** 2, np.fft.rfftfreq(noise.size, 1 / 200.0)
    outside = (bins < 29.5) | (bins > 80.5)
    assert spectrum[outside].max() < 1e-20 * spectrum.max()


def test_noise_of_one_channel_has_its_power() -> None:
    """It was an IndexError: between one centre and no other nothing could be interpolated."""
    (noise,) = draw_noise(np.array([50.0]), np.array([[3.0]]), 1 << 20, 200.0, np.random.default_rng(2))
    assert np.mean(noise**2) == pytest.approx(50.0 * 3.0, rel=0.05)


def test_a_single_amplitude_is_that_of_the_convention() -> None:
    """Written out: a flat spectrum P has <|X|^2> = n f_s P R / 2, and its real and imaginary parts are independent."""
    noise = draw_noise(np.array([30.0, 60.0]), np.full((20_000, 2), 3.0), 8, 200.0, np.random.default_rng(5))
    found = np.array(
        [sum(one * np.exp(-2j * np.pi * 2 * t / 8) for t, one in enumerate(row)) for row in noise]
    )  # 50 MHz
    assert np.mean(np.abs(found) ** 2) == pytest.approx(8 * 200.0 * 3.0 * 50.0 / 2.0, rel=0.03)
    assert abs(np.mean(found**2)) < 0.03 * np.mean(np.abs(found) ** 2)


def test_a_rate_that_is_too_low_is_refused() -> None:
    with pytest.raises(BadInputError, match="161 MHz, found 1024, 160"):
        draw_noise(CHANNELS, POWER[None], 1024, 160.0, np.random.default_rng(6))


def test_a_negative_density_is_refused() -> None:
    with pytest.raises(BadInputError, match="densities"):
        draw_noise(CHANNELS, -POWER[None], 1024, 200.0, np.random.default_rng(0))


def test_every_channel_has_the_density_that_was_asked_for() -> None:
    samples, trials = 2000, 1500
    noise = draw_noise(CHANNELS, np.tile(POWER, (trials, 1)), samples, 200.0, np.random.default_rng(3))
    density = 2 * np.mean(np.abs(np.fft.rfft(noise, axis=1)) ** 2, axis=0) / (samples * 200.0 * 50.0)
    at = np.searchsorted(np.fft.rfftfreq(samples, 1 / 200.0), CHANNELS - 1e-6)
    # a mean of 1500 exponential variables scatters by 2.6 %
    np.testing.assert_allclose(density[at], POWER, rtol=0.12)
