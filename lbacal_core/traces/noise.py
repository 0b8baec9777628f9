"""Noise in the time domain from a power spectrum: the inverse of what `lbacal spectra` measures in traces."""

from __future__ import annotations

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, guess_widths
from lbacal_core.instrument.matching import RESISTANCE_OHM


def draw_noise(
    frequency_mhz: Floats, power: Floats, samples: int, sample_rate_mhz: float, rng: np.random.Generator
) -> Floats:
    """Gaussian noise with a one-sided power spectrum as spectra files have it, shape (trace, sample).

    Each Fourier amplitude X_k is complex normal with <|X_k|^2> = n f_s P R_r / 2, so that the mean square of the
    samples is the sum of P x width x R_r over the channels (Parseval). Between centres of channels ln P is linear;
    outside the channels there is no noise. A trace is periodic: its end goes on at its beginning.

    Parameters
    ----------
    power
        P, shape (trace, freq): ADC^2/Ohm/MHz gives ADC units, W/MHz gives V.
    samples
        Number of samples n of each trace.
    sample_rate_mhz
        f_s, at least twice the highest frequency.
    """
    if power.shape[-1:] != frequency_mhz.shape or not np.all(power > 0):
        raise BadInputError("power", f"{frequency_mhz.size} densities > 0 of each trace", f"shape {power.shape}")
    edge = guess_widths(frequency_mhz)[[0, -1]] / 2.0 * [-1.0, 1.0] + frequency_mhz[[0, -1]]
    if not isinstance(samples, int | np.integer) or samples < 2 or not sample_rate_mhz >= 2.0 * edge[1]:
        expected = f"two samples or more, at least {2.0 * edge[1]:g} MHz"
        raise BadInputError("samples, sample_rate_mhz", expected, f"{samples}, {sample_rate_mhz:g}")
    bins = np.fft.rfftfreq(samples, 1.0 / sample_rate_mhz)
    inside = (bins >= edge[0]) & (bins <= edge[1])
    if not inside.any():
        expected = f"so many samples that a bin lies between {edge[0]:g} and {edge[1]:g} MHz"
        raise BadInputError("samples, sample_rate_mhz", expected, f"{samples}, {sample_rate_mhz:g}")
    density = np.exp([np.interp(bins, frequency_mhz, level) for level in np.log(power)]) * inside
    normal = rng.standard_normal((2, *density.shape))
    amplitude = (normal[0] + 1j * normal[1]) * np.sqrt(samples * sample_rate_mhz * RESISTANCE_OHM / 4.0 * density)
    return np.asarray(np.fft.irfft(amplitude, samples, axis=1))
