"""The noise of an antenna from its fitted chain, as spectrum and as realisations, for simulations."""

from __future__ import annotations

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.matching import RESISTANCE_OHM


def draw_noise(
    power: Floats,
    frequency_mhz: Floats,
    samples: int,
    sample_rate_mhz: float,
    rng: np.random.Generator,
    realisations: int = 1,
) -> Floats:
    """Draw Gaussian noise with a power density, zero outside its channels.

    Each FFT bin is a complex normal variable whose mean square follows from the one-sided density, so that the sum
    of the density times width times R_r over the band is the mean square of the samples (docs/formats/spectra.md).

    Parameters
    ----------
    power
        One-sided density, shape (freq,), ADC^2/Ohm/MHz; times C^2 it is V^2/Ohm/MHz, and the noise is in V.
    frequency_mhz
        Channels, shape (freq,), MHz.

    Returns
    -------
    Shape (realisation, sample), ADC units (or V).
    """
    if power.shape != frequency_mhz.shape or not np.all(power >= 0):
        raise BadInputError("power", f"{frequency_mhz.size} densities >= 0", f"shape {power.shape}")
    bins = np.fft.rfftfreq(samples, 1.0 / sample_rate_mhz)
    edges = (frequency_mhz[0] - 0.5, frequency_mhz[-1] + 0.5)
    if edges[1] > sample_rate_mhz / 2:
        raise BadInputError(
            "sample_rate_mhz", f"at least {2 * edges[1]:g}, twice the highest frequency", f"{sample_rate_mhz:g}"
        )
    is_inside = (bins >= edges[0]) & (bins <= edges[1])
    density = np.where(is_inside, np.interp(bins, frequency_mhz, power), 0.0) * RESISTANCE_OHM
    # a pair of bins carries density x bin width of the mean square: |X|^2 = density x rate/N x N^2/2
    scale = np.sqrt(density * sample_rate_mhz * samples / 2.0)
    parts = rng.normal(scale=np.sqrt(0.5), size=(2, realisations, bins.size))
    return np.fft.irfft((parts[0] + 1j * parts[1]) * scale, samples, axis=1)
