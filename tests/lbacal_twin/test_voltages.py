"""Voltages against the formulas of physics, and against the twin of spectra."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import SkyPower
from lbacal_core.traces.background import CleaningSettings, measure_traces
from lbacal_core.traces.density import bin_weights, effective_channels
from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace, TraceReference
from lbacal_twin.campaign import expected_power
from lbacal_twin.gains import draw_scatter
from lbacal_twin.hardware import Scene, Stages, build_station
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View
from lbacal_twin.voltages import SAMPLE_RATE_HZ, Shower, Transmitter, digitise, draw_noise
from lbacal_twin.weather import draw_weather

FREQUENCY = np.arange(30.0, 81.0)


def test_drawn_noise_has_its_density_and_falls_off_outside() -> None:
    voltage = draw_noise(np.full(51, 3.0), FREQUENCY, 1 << 20, np.random.default_rng(1))
    power = np.abs(np.fft.rfft(voltage)) ** 2 * 2 / (200.0 * voltage.size)
    mhz = np.fft.rfftfreq(voltage.size, 1 / 200)
    assert np.mean(power[(mhz > 30) & (mhz < 80)]) == pytest.approx(3.0, rel=0.006)  # 262,000 channels, 3 sigma
    assert np.mean(power[(mhz > 95) & (mhz < 96)]) == pytest.approx(3.0 * np.exp(-15.0 / 3), rel=0.1)


def test_a_transmitter_has_its_power_frequency_drift_and_duty() -> None:
    samples = 1 << 18
    steady = Transmitter(41.3, mean_square=50.0).voltage(samples, 200e6)
    assert np.mean(steady**2) == pytest.approx(50.0, rel=1e-3)
    half = Transmitter(41.3, mean_square=50.0, duty=0.25, period_s=samples / 8 / 200e6).voltage(samples, 200e6)
    assert np.mean(half**2) == pytest.approx(12.5, rel=1e-2)
    drifting = Transmitter(41.0, 1.0, drift_mhz_per_ms=0.5).voltage(samples, 200e6)
    last = np.abs(np.fft.rfft(drifting[-32768:]))
    middle_ms = (samples - 16384) / 200e3
    assert np.argmax(last) * 200 / 32768 == pytest.approx(41.0 + 0.5 * middle_ms, abs=0.05)


def test_a_shower_peaks_where_it_is_told_and_stays_in_its_band() -> None:
    voltage = Shower(sample=5000, peak=700.0).voltage(1 << 14, 200e6)
    assert np.argmax(voltage) == 5000
    assert voltage.max() == pytest.approx(700.0)
    spectrum = np.abs(np.fft.rfft(voltage))
    mhz = np.fft.rfftfreq(voltage.size, 1 / 200)
    outside = (mhz < 28) | (mhz > 82)
    assert np.sum(spectrum[outside] ** 2) < 1e-3 * np.sum(spectrum**2)


def test_the_converter_rounds_and_clips_to_twelve_bits() -> None:
    assert digitise(np.array([0.4, 0.6, -5000.0, 5000.0])).tolist() == [0, 1, -2048, 2047]


def _station(instrument: Instrument, sky_power: SkyPower) -> tuple[Stages, Scene]:
    scene = Scene(
        station="CS002", latitude_deg=instrument.latitude_deg, longitude_deg=instrument.longitude_deg,
        frequency_mhz=instrument.frequency_mhz, antennas=np.arange(2), cables=np.array(["50", "80"]),
        time_unix=np.array([1.4e9]), lst_hours=np.array([18.0]), temperature_c=np.array([10.0]),
        rain_mm_h=np.array([0.0]), sky_power=sky_power,
        weather=draw_weather(np.array([1.4e9]), instrument.longitude_deg, np.random.default_rng(5)),
        view=View(instrument),
    )  # fmt: skip
    return build_station(TwinSettings(), instrument, scene, np.random.default_rng(2))[0], scene


def draw_chain_voltage(stages: Stages, path: tuple[int, int, int], samples: int, rng: np.random.Generator) -> Floats:
    """What reaches the converter of one path in one event, every noise source through the stages behind it."""
    at = {
        name: np.broadcast_to(values, (*np.maximum(np.shape(values)[:3], np.add(path, 1)), FREQUENCY.size))[path]
        for name, values in vars(stages).items()
    }
    behind_antenna = at["gain"] * at["antenna"] * at["cable"] * at["receiver"]
    sources = at["sky"] * behind_antenna, at["lna_noise"] * behind_antenna, at["rcu_noise"] * at["receiver"]
    voltage = sum(draw_noise(power * 50.0, FREQUENCY, samples, rng) for power in sources)
    level = float(np.mean(at["adc_noise"])) * 50.0  # white from 0 to half the sample rate
    return voltage + rng.normal(scale=np.sqrt(level * 1e-6 * SAMPLE_RATE_HZ / 2.0), size=samples)


def _measure(stages: Stages, blocks: int, rng: np.random.Generator, scale: float) -> tuple[np.ndarray, Trace]:
    """One spectrum by way of voltages; `scale` brings the chain's arbitrary unit to ADC units."""
    voltage = draw_chain_voltage(stages, (1, 0, 0), blocks * BLOCK_SAMPLES, rng) * scale
    reference = TraceReference(Path("twin"), "2", "CS002", 2, 1_400_000_000, 0, 200e6)
    samples = digitise(voltage).reshape(-1, BLOCK_SAMPLES)
    trace = Trace(reference, samples, np.arange(blocks), np.ones(blocks, dtype=bool), {})
    (found,) = measure_traces([trace], CleaningSettings(), is_station=False)
    return found.power, trace


def test_the_twin_of_spectra_agrees_with_the_twin_of_voltages(low_band: Instrument, two_waves: SkyPower) -> None:
    stages, scene = _station(low_band, two_waves)
    expected = expected_power(stages, scene, ())[1, 0, 0]
    scale = 20.0 / np.sqrt(expected.sum() * 50.0)
    rng = np.random.default_rng(3)
    blocks, trials = 100, 60
    powers = np.array([_measure(stages, blocks, rng, scale)[0] for _ in range(trials)])
    rounding = 1 / 12 / 100 / 50
    ratio = powers.mean(axis=0) / (expected * scale**2 + rounding)
    # 5.7 % / sqrt(60) = 0.7 % a channel. Where the band bends, the mean over a MHz is up to 0.4 % off its centre.
    assert np.abs(ratio - 1).max() < 0.035
    assert ratio.mean() == pytest.approx(1.0, abs=0.004)
    # The scatter of the spectra is the radiometer noise of the spectrum twin once the window is told to it.
    channels = effective_channels(bin_weights(np.arange(513) * 200 / 1024, FREQUENCY, 1.0)).mean()
    told = TwinSettings(radiometer=float(1 / np.sqrt(100 * channels)), event_gain_common=0.0, event_gain_path=0.0)
    drawn = draw_scatter(told, np.full((1, 1, trials), blocks), 51, np.random.default_rng(4))[0, 0]
    measured = powers / powers.mean(axis=0)
    assert measured.std() == pytest.approx(drawn.std(), rel=0.06)  # 60 x 51 values each: 1.3 %, neighbours correlated
