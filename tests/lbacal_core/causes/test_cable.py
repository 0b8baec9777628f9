from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.causes.cable import CableReflection

FREQUENCY = np.arange(30.0, 81.0)


def test_a_ripple_is_the_mean_of_the_wave_over_each_channel():
    """Against the plain mean of the monochromatic wave over 1 MHz."""
    fine = (np.arange(400) + 0.5) / 400 - 0.5
    for shape in CableReflection().templates(FREQUENCY, None)[::17]:
        delay, phase = shape.parameters["delay_us"], np.radians(shape.parameters["phase_deg"])
        wave = np.cos(2 * np.pi * delay * (FREQUENCY[:, None] + fine) - phase)
        np.testing.assert_allclose(shape.departure, wave.mean(axis=1), atol=1e-5)


def test_no_ripple_falls_between_those_that_are_tried():
    tried = np.stack([shape.departure for shape in CableReflection().templates(FREQUENCY, None)])
    tried /= np.linalg.norm(tried, axis=1, keepdims=True)
    rng = np.random.default_rng(1)
    for delay, phase in zip(rng.uniform(0.05, 0.95, 60), rng.uniform(0, 6.3, 60), strict=True):
        ripple = np.cos(2 * np.pi * delay * FREQUENCY + phase)
        # Half a step in delay and in phase off: sinc(0.005 us x 51 MHz) cos(22.5 deg) = 0.83.
        assert np.abs(tried @ ripple).max() > 0.8 * np.linalg.norm(ripple)


def test_the_note_names_the_delay_that_looks_the_same_with_its_amplitude():
    cause = CableReflection()
    (shape,) = (
        s
        for s in cause.templates(FREQUENCY, None)
        if s.parameters == pytest.approx({"delay_us": 0.35, "phase_deg": 0.0, "or_delay_us": 0.65})
    )
    note = cause.note(shape.parameters, 0.01)
    assert "0.65 us" in note
    assert f"{0.01 * np.sinc(0.35) / np.sinc(0.65):.2g}" in note
    about = cause.finer_templates(shape, FREQUENCY)
    assert any(np.allclose(one.departure, -shape.departure) for one in about)


def test_two_channels_close_to_each_other_asked_for_50_000_delays_and_9_gigabytes():
    uneven = np.sort(np.r_[np.random.default_rng(1).uniform(40.0, 117.0, 150), 60.0, 60.0001])
    tried = CableReflection().templates(uneven, None)
    assert len(tried) < 4 * 2 * uneven.size
    longest = max(template.parameters["delay_us"] for template in tried)
    assert longest < 1.0 / np.median(np.diff(uneven))


def test_finer_channels_reach_longer_delays():
    """With channels of 0.39 MHz an echo of 0.85 us was named 0.026 us."""
    fine = np.arange(50.0, 70.0, 0.39)
    delays = {template.parameters["delay_us"] for template in CableReflection().templates(fine, None)}
    assert min(abs(delay - 0.85) for delay in delays) < 0.5 / np.ptp(fine)


def test_a_ripple_that_is_zero_in_every_channel_was_named_with_an_amplitude_of_3e11():
    """A sine of half a period a channel is a rounding error in each, and every antenna has some multiple of it."""
    cause = CableReflection()
    tried = cause.templates(FREQUENCY, None)
    longest = [one for one in tried if one.parameters["delay_us"] == pytest.approx(0.5)]
    assert {one.parameters["phase_deg"] for one in longest} == {0.0, 45.0, 135.0}
    about = cause.finer_templates(longest[0], FREQUENCY)
    assert min(np.abs(one.departure).max() for one in [*tried, *about]) > 0.1
