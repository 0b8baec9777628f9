"""What an antenna records of a pulse, and the field that a calibration makes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lbacal_core.antenna.model import AntennaModel, Complexes
from lbacal_core.antenna.unfolding import jones_matrix
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import RESISTANCE_OHM
from lbacal_paper.showers.signals import SAMPLE_RATE_MHZ, SAMPLES, Signals

BACKGROUND_BLOCKS = 100
"""Blocks of the same event from which the background of each dipole is averaged."""


@dataclass(frozen=True)
class Recording:
    """Pulses as recorded.

    Attributes
    ----------
    spectrum
        `numpy.fft.rfft` of the samples, pulse and background, shape (signal, dipole, bin), ADC units.
    background
        Mean |FFT|^2 of blocks of the same event without the pulse, shape (signal, dipole, bin), ADC units squared.
    jones
        J of each signal's direction, shape (signal, bin, dipole, component), m.
    """

    signals: Signals
    spectrum: Complexes
    background: Floats
    jones: Complexes

    @cached_property
    def inverse_jones(self) -> Complexes:
        """Component of the field by voltage, shape (signal, bin, component, dipole), 1/m."""
        return np.asarray(np.linalg.inv(self.jones))


def record(
    signals: Signals,
    instrument: Instrument,
    antenna: AntennaModel,
    c: Floats,
    background_power: Floats,
    rng: np.random.Generator,
    signal_to_noise: tuple[float, float] = (30.0, 3000.0),
) -> Recording:
    """Record pulses with antennas whose calibration is `c`, in a background of known power.

    Parameters
    ----------
    c
        True C of both dipoles, shape (2, freq) on the instrument's channels, V per ADC unit.
    background_power
        Recorded background of both dipoles, shape (2, freq), ADC^2/Ohm/MHz.
    signal_to_noise
        Each event is scaled so that the mean power of its signals over that of the background, 45-65 MHz, lies in this
        range (drawn evenly in the logarithm): the strongest events of an experiment.
    """
    jones = _jones_of(signals, instrument, antenna)
    channels, bins = instrument.frequency_mhz, signals.frequency_mhz
    c_at = np.array([np.interp(bins, channels, one) for one in c])
    density = np.array([np.interp(bins, channels, one) for one in background_power])
    expected = density * RESISTANCE_OHM * SAMPLE_RATE_MHZ * SAMPLES / 2.0
    pulse = np.einsum("sbij,sjb->sib", jones, signals.field) / c_at
    middle = (bins > 45.0) & (bins < 65.0)
    ratio = (np.abs(pulse) ** 2 / expected)[:, :, middle].mean(axis=(1, 2))
    events = int(signals.event.max()) + 1
    mean_ratio = np.array([ratio[signals.event == k].mean() for k in range(events)])
    wanted = np.exp(rng.uniform(np.log(signal_to_noise[0]), np.log(signal_to_noise[1]), size=events))
    scale = np.sqrt(wanted / mean_ratio)[signals.event][:, None, None]
    noise = rng.normal(scale=np.sqrt(0.5), size=(2, *pulse.shape))
    spectrum = scale * pulse + (noise[0] + 1j * noise[1]) * np.sqrt(expected)
    averaged = rng.standard_gamma(BACKGROUND_BLOCKS, size=pulse.shape) / BACKGROUND_BLOCKS
    scaled = replace(signals, field=scale * signals.field)
    return Recording(scaled, spectrum, expected * averaged, jones)


def field_power(
    recording: Recording, c: Floats, channels_mhz: Floats, *, subtract: bool = True
) -> tuple[Floats, Floats]:
    """Power spectrum |E_theta|^2 + |E_phi|^2 with a calibration, and the mean power of the background in it.

    Parameters
    ----------
    c
        The calibration to be applied, shape (2, freq), or (signal, 2, freq) for one of each signal's own.
    subtract
        Whether the mean background of the event, carried through the same calibration and unfolding, is subtracted.

    Returns
    -------
    Both of shape (signal, bin).
    """
    bins = recording.signals.frequency_mhz
    each = np.broadcast_to(c, (recording.spectrum.shape[0], 2, channels_mhz.size))
    c_at = _interpolate(each, channels_mhz, bins)
    inverse = recording.inverse_jones
    field = np.einsum("sbij,sjb->sib", inverse, c_at * recording.spectrum)
    power = np.sum(np.abs(field) ** 2, axis=1)
    weight = np.einsum("sbij->sjb", np.abs(inverse) ** 2) * c_at**2
    background = np.sum(weight * recording.background, axis=1)
    return np.asarray(power - background if subtract else power), np.asarray(background)


def true_power(recording: Recording) -> Floats:
    """|E_theta|^2 + |E_phi|^2 of the pulses themselves, shape (signal, bin)."""
    return np.asarray(np.sum(np.abs(recording.signals.field) ** 2, axis=1))


def _interpolate(values: Floats, channels: Floats, bins: Floats) -> Floats:
    """Linear interpolation along the last axis."""
    above = np.clip(np.searchsorted(channels, bins), 1, channels.size - 1)
    share = (bins - channels[above - 1]) / (channels[above] - channels[above - 1])
    return np.asarray(values[..., above - 1] * (1.0 - share) + values[..., above] * share)


def _jones_of(signals: Signals, instrument: Instrument, antenna: AntennaModel) -> Complexes:
    bins = signals.frequency_mhz
    gain = np.exp(np.interp(bins, instrument.frequency_mhz, np.log(instrument.antenna_gain)))
    result = np.empty((signals.event.size, bins.size, 2, 2), dtype=complex)
    for number in np.unique(signals.event):
        rows = signals.event == number
        first = int(np.flatnonzero(rows)[0])
        zenith, azimuth = float(signals.zenith_deg[first]), float(signals.azimuth_deg[first])
        result[rows] = jones_matrix(antenna, gain, instrument.dipole_azimuth_deg, bins, zenith, azimuth)
    return result
