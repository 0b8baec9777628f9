from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_paper.showers.coreas import read_coreas
from lbacal_paper.showers.signals import EVENTS, SAMPLES, SIGNALS, band_bins, draw_signals, signals_of_showers


def test_the_spectrum_of_a_sampled_pulse_is_its_fourier_transform(hdf5_shower: Path) -> None:
    signals = signals_of_showers([read_coreas(hdf5_shower)])
    # a Gaussian of 2 ns and 1 V/m: sqrt(2 pi) sigma exp(-2 (pi nu sigma)^2), times the sampling rate
    omega = 2 * np.pi * 1e6 * signals.frequency_mhz
    expected = 200e6 * np.sqrt(2 * np.pi) * 2e-9 * np.exp(-0.5 * (omega * 2e-9) ** 2)
    assert np.abs(signals.field[1, 1]) == pytest.approx(expected, rel=1e-6)
    assert np.abs(signals.field[0, 0]) == pytest.approx(0.5 * expected, rel=1e-6)


def test_a_sampled_pulse_stands_in_the_middle_of_its_block(hdf5_shower: Path) -> None:
    signals = signals_of_showers([read_coreas(hdf5_shower)])
    spectrum = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    at = np.isin(np.fft.rfftfreq(SAMPLES, 1 / 200.0), signals.frequency_mhz)
    spectrum[at] = signals.field[1, 1]
    assert np.argmax(np.abs(np.fft.irfft(spectrum, SAMPLES))) == SAMPLES // 2


def test_drawn_signals_have_the_numbers_of_the_paper_and_straight_spectra() -> None:
    signals = draw_signals(np.random.default_rng(1))
    assert np.unique(signals.event).size == EVENTS == 20
    assert signals.event.size == SIGNALS == 1653
    power = np.log10(np.sum(np.abs(signals.field) ** 2, axis=1))
    slope = np.diff(power, axis=1) / np.diff(band_bins())
    assert slope == pytest.approx(slope[:, :1] * np.ones_like(slope), abs=1e-9)
    assert signals.zenith_deg.max() <= 50
