"""Pulses as band-limited spectra at antennas: from CoREAS showers, or drawn as a labelled stand-in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.model import Complexes
from lbacal_core.grids import Floats
from lbacal_paper.showers.coreas import Shower

SAMPLE_RATE_MHZ = 200.0
SAMPLES = 256
"""1.28 us around the pulse: FFT bins of 0.78 MHz."""
EVENTS, SIGNALS = 20, 1653
"""The data set of the paper's comparison with CoREAS."""
STAND_IN = "exponential pulses drawn as a stand-in for showers"
BAND_MHZ = (30.0, 80.0)


@dataclass(frozen=True)
class Signals:
    """Electric fields of pulses at antennas.

    Attributes
    ----------
    origin
        The showers they come from, or `STAND_IN`.
    frequency_mhz
        FFT bins in the band, shape (bin,).
    field
        E_theta and E_phi as `numpy.fft.rfft` of samples, shape (signal, 2, bin), V/m.
    zenith_deg, azimuth_deg, event
        Direction and number of the shower of each signal, shape (signal,).
    """

    origin: str
    frequency_mhz: Floats
    field: Complexes
    zenith_deg: Floats
    azimuth_deg: Floats
    event: NDArray[np.int64]


def band_bins() -> Floats:
    """The FFT bins inside the band, MHz."""
    bins = np.asarray(np.fft.rfftfreq(SAMPLES, 1.0 / SAMPLE_RATE_MHZ), dtype=np.float64)
    return bins[(bins >= BAND_MHZ[0]) & (bins <= BAND_MHZ[1])]


def signals_of_showers(showers: Sequence[Shower]) -> Signals:
    """The fields of all antennas of some showers, band-limited and sampled at 200 MHz.

    The Fourier transform of the simulated field is evaluated at the FFT bins of the band alone, which is what an ideal
    filter and a sampler after it give; times count from the largest field, which stands in the middle of the block.
    """
    bins = band_bins()
    middle = SAMPLES / 2 / (1e6 * SAMPLE_RATE_MHZ)
    parts = []
    for shower in showers:
        on_sky = shower.on_sky()
        strongest = np.argmax(np.sum(on_sky**2, axis=2), axis=1)
        rows = np.arange(strongest.size)
        time = shower.time_s - shower.time_s[rows, strongest][:, None] + middle
        step = float(np.mean(np.diff(shower.time_s[0])))
        waves = np.exp(-2j * np.pi * 1e6 * time[:, :, None] * bins)
        parts.append(1e6 * SAMPLE_RATE_MHZ * step * np.einsum("atb,atc->acb", waves, on_sky))
    sizes = [part.shape[0] for part in parts]
    return Signals(
        ", ".join(shower.name for shower in showers),
        bins,
        np.concatenate(parts),
        np.repeat([shower.zenith_deg for shower in showers], sizes),
        np.repeat([shower.azimuth_deg for shower in showers], sizes),
        np.repeat(np.arange(len(showers)), sizes),
    )


def draw_signals(rng: np.random.Generator, events: int = EVENTS, signals: int = SIGNALS) -> Signals:
    """Draw pulses whose power falls exponentially along frequency, in the number of the paper: a stand-in for showers.

    Each event has a direction and a typical slope, each antenna a slope about it, as with the distance to the core; the
    power is a straight line in ln against frequency over the whole band, as CoREAS pulses nearly are. Amplitudes are in
    arbitrary units.
    """
    bins = band_bins()
    event = np.sort(np.concatenate([np.arange(events), rng.integers(events, size=signals - events)]))
    typical = rng.normal(-0.018, 0.006, events)
    slope = typical[event] + rng.normal(0.0, 0.006, signals)
    angle = rng.uniform(0, np.pi, events)[event] + rng.normal(0.0, 0.15, signals)
    phase = np.exp(-2j * np.pi * bins * SAMPLES / 2 / SAMPLE_RATE_MHZ)
    amplitude = 10.0 ** (0.5 * slope[:, None] * (bins - 55.0)) * phase
    return Signals(
        STAND_IN,
        bins,
        np.stack([np.cos(angle)[:, None] * amplitude, np.sin(angle)[:, None] * amplitude], axis=1),
        np.degrees(np.arccos(rng.uniform(np.cos(np.radians(50.0)), 1.0, events)))[event],
        rng.uniform(0.0, 360.0, events)[event],
        event.astype(np.int64),
    )
