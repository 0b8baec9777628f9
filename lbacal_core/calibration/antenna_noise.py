"""The noise of an antenna from its fitted chain, as spectrum and as realisations, for simulations."""

from __future__ import annotations

import numpy as np

from lbacal_core.chain.model import noise_constants
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.power import RESISTANCE_OHM
from lbacal_core.skypower.table import SkyPower

# What a fitted curve predicts, term by term.


def noise_at_input(curve: CalibrationCurve, instrument: Instrument) -> dict[str, Floats]:
    """The noise terms of a fitted curve referred to the start of the chain (Fig. 5 of the paper).

    Each constant divided by what amplifies the sky up to the point where it was fitted: those behind A by
    G_ant / C^2.

    Returns
    -------
    By name of the stage (`lna`, `rcu` and `adc` of a chain without stages), each shape (freq,), in the unit of P_sky;
    `known` is what the instrument states without an error.
    """
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    slope, noise = instrument.antenna_gain / curve.c**2, noise_constants(instrument)
    value = np.array([curve.parameters[name].value for name in noise.names])
    forms = np.concatenate([noise.front, noise.behind / slope])
    terms = {name.removeprefix("n_"): one for name, one in zip(noise.names, value[:, None] * forms, strict=True)}
    return terms | ({"known": noise.known} if np.any(noise.known) else {})


def predict_power(curve: CalibrationCurve, instrument: Instrument, sky: Floats) -> Floats:
    """Recorded power of a fitted path for a sky power of shape (event, freq)."""
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    return np.asarray((sky + sum(noise_at_input(curve, instrument).values())) * instrument.antenna_gain / curve.c**2)


def recorded_background(
    curve: CalibrationCurve, instrument: Instrument, sky_power: SkyPower, lst_hours: Floats
) -> Floats:
    """Recorded background of a fitted path, sky and electronics, shape (event, freq), ADC^2/Ohm/MHz.

    Parameters
    ----------
    lst_hours
        Shape (event,), hours.
    """
    dipole = curve.dipole
    if dipole is None:
        raise BadInputError(curve.name, "a curve of one polarisation", "one for both")
    sky = sky_power.of_station(curve.station)
    return predict_power(curve, instrument, sky.at(dipole, np.asarray(lst_hours, dtype=float)))


def recorded_electronics(curve: CalibrationCurve, instrument: Instrument) -> Floats:
    """Recorded power without the sky, shape (freq,), ADC^2/Ohm/MHz: N_ADC, N_RCU and N_LNA behind their stages."""
    without_sky = np.zeros((1, instrument.frequency_mhz.size))
    return np.asarray(predict_power(curve, instrument, without_sky)[0])


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
    of the density times width times R_r over the band is the mean square of the samples (docs/formats.md).

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
