"""The twin in voltages: noise, transmitters, an air shower, 12-bit converters, frames of a dump.

Works from raw physics; nothing here knows how the traces will be cleaned. Voltages are in ADC units across R_r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.traces.trace import (
    ADC_HIGHEST,
    ADC_LOWEST,
    BLOCK_SAMPLES,
    FRAME,
    TraceReference,
    header_checksums,
    sample_checksums,
)

SAMPLE_RATE_HZ = 200e6
EDGE_MHZ = 3.0
"""Outside the instrument's channels every power falls by a factor e in this width, as behind an anti-alias filter."""


@dataclass(frozen=True)
class Transmitter:
    """A narrow line, as one antenna receives it.

    Attributes
    ----------
    frequency_mhz
        At the first sample.
    mean_square
        Power while it transmits, ADC^2.
    drift_mhz_per_ms
        Change of frequency.
    duty, period_s
        Fraction of every period in which it transmits.
    phase
        Phase of the carrier at the first sample, rad; it differs between antennas.
    """

    frequency_mhz: float
    mean_square: float
    drift_mhz_per_ms: float = 0.0
    duty: float = 1.0
    period_s: float = 2e-4
    phase: float = 0.0

    def voltage(self, samples: int, rate_hz: float) -> Floats:
        """Voltage over time, shape (sample,)."""
        time = np.arange(samples) / rate_hz
        turns = time * (1e6 * self.frequency_mhz) + 0.5 * self.drift_mhz_per_ms * 1e9 * time**2
        carrier = np.sqrt(2.0 * self.mean_square) * np.cos(2 * np.pi * turns + self.phase)
        return np.asarray(carrier * ((time / self.period_s) % 1.0 < self.duty))


@dataclass(frozen=True)
class Shower:
    """A radio pulse: an impulse as short as the band allows.

    Attributes
    ----------
    sample
        Where it peaks.
    peak
        Largest voltage, ADC units.
    low_mhz, high_mhz
        The band that the chain lets through.
    """

    sample: int
    peak: float
    low_mhz: float = 30.0
    high_mhz: float = 80.0

    def voltage(self, samples: int, rate_hz: float) -> Floats:
        """Voltage over time, shape (sample,)."""
        time = (np.arange(samples) - self.sample) / rate_hz
        high, low = 2e6 * self.high_mhz, 2e6 * self.low_mhz
        return np.asarray(self.peak * (high * np.sinc(high * time) - low * np.sinc(low * time)) / (high - low))


def draw_noise(density: Floats, density_mhz: Floats, samples: int, rng: np.random.Generator) -> Floats:
    """Draw Gaussian noise of a one-sided power density.

    Parameters
    ----------
    density, density_mhz
        Shape (freq,), ADC^2/MHz and MHz, interpolated, and falling off outside.
    samples
        Length of the trace.

    Returns
    -------
    Shape (sample,), ADC units.
    """
    frequency = np.fft.rfftfreq(samples, 1e6 / SAMPLE_RATE_HZ)
    half = (density_mhz[1] - density_mhz[0]) / 2.0  # the outermost channels are as wide as the others
    outside = np.maximum(density_mhz[0] - half - frequency, 0.0) + np.maximum(frequency - density_mhz[-1] - half, 0.0)
    level = np.exp(np.interp(frequency, density_mhz, np.log(density)) - outside / EDGE_MHZ)
    amplitude = np.sqrt(level * 1e-6 * SAMPLE_RATE_HZ * samples / 4.0)
    spectrum = amplitude * (rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size))
    spectrum[0] = 0.0
    return np.asarray(np.fft.irfft(spectrum, samples))


def digitise(
    voltage: Floats, disturbances: Sequence[Transmitter | Shower] = (), rate_hz: float = SAMPLE_RATE_HZ
) -> NDArray[np.int16]:
    """Convert a voltage and what disturbs it to the integers of a 12-bit converter, clipped to its range.

    Rounding adds noise of 1/12 ADC^2, white where the voltage moves by more than one unit (Widrow 1956).
    """
    total = voltage.copy()
    for disturbance in disturbances:
        total += disturbance.voltage(voltage.size, rate_hz)
    return np.clip(np.rint(total), ADC_LOWEST, ADC_HIGHEST).astype(np.int16)


def write_frames(path: Path, samples: NDArray[np.int16], reference: TraceReference, station_id: int) -> None:
    """Write samples as the raw frames of a transient buffer board, checksums included."""
    count = samples.size // BLOCK_SAMPLES
    frames = np.zeros(count, dtype=FRAME)
    number = reference.start_sample + np.arange(count, dtype=np.int64) * BLOCK_SAMPLES
    second = int(reference.sample_rate_hz)
    frames["station"] = station_id
    frames["rsp"] = reference.rcu // 8
    frames["rcu"] = reference.rcu
    frames["sample_rate_mhz"] = round(reference.sample_rate_hz / 1e6)
    frames["sequence"] = np.arange(count)
    frames["time"] = reference.start_s + number // second
    frames["sample"] = number % second
    frames["samples_per_frame"] = BLOCK_SAMPLES
    frames["samples"] = samples[: count * BLOCK_SAMPLES].reshape(count, BLOCK_SAMPLES)
    frames["header_crc"] = header_checksums(frames)
    frames["samples_crc"] = sample_checksums(frames["samples"])
    path.write_bytes(frames.tobytes())
