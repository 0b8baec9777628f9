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


# Slopes of log power against frequency in the two bands of the paper's section 5.1, and their contours.

LOW_MHZ, HIGH_MHZ = (30.0, 58.0), (62.0, 78.0)
"""Below and above the resonance; above 78 MHz the electronics are too uncertain."""
SHARE = 0.68
FLOOR = 0.01
"""Scatter of strong spectra about a straight line, a fraction of the power: one strong bin does not decide alone."""
STEPS = 12
LARGEST_STEP = 0.05
"""Change of the slope of ln power in one step, per MHz."""
STEEPEST = 0.5
"""Slope of ln power per MHz beyond which no pulse lies."""
LARGEST_SIGMA = 0.01
"""A slope less certain than this, of log10 power per MHz, is not counted: it is as wide as all showers together."""


@dataclass(frozen=True)
class Slopes:
    """Slopes d log10(power)/d nu of signals in both bands, per MHz.

    Attributes
    ----------
    low, high
        Shape (signal,); NaN where the background leaves the slope less certain than `LARGEST_SIGMA`.
    low_sigma, high_sigma
        Standard deviations from the background, shape (signal,).
    """

    low: Floats
    high: Floats
    low_sigma: Floats
    high_sigma: Floats

    @property
    def difference(self) -> Floats:
        """Slope above minus slope below the resonance of the signals that have both, per MHz: 0 on the diagonal."""
        both = np.isfinite(self.low) & np.isfinite(self.high)
        return np.asarray((self.high - self.low)[both])

    def contour(self, points: int = 73) -> tuple[Floats, Floats]:
        """The ellipse of the sample's covariance that holds 68 % of the signals; slopes below and above."""
        both = np.isfinite(self.low) & np.isfinite(self.high)
        sample = np.stack([self.low[both], self.high[both]])
        mean, covariance = np.median(sample, axis=1), robust_covariance(sample)
        distance = mahalanobis(sample - mean[:, None], covariance)
        radius = float(np.sqrt(np.quantile(distance, SHARE)))
        angle = np.linspace(0.0, 2 * np.pi, points)
        circle = radius * np.stack([np.cos(angle), np.sin(angle)])
        size, axes = np.linalg.eigh(covariance)
        ellipse = mean[:, None] + axes @ (np.sqrt(np.maximum(size, 0.0))[:, None] * circle)
        return ellipse[0], ellipse[1]


def robust_covariance(sample: Floats) -> Floats:
    """Covariance of the 95 % of points nearest to the median, shape (2, 2): a few weak signals do not decide it."""
    offset = sample - np.median(sample, axis=1)[:, None]
    distance = mahalanobis(offset, np.cov(offset))
    return np.asarray(np.cov(offset[:, distance <= np.quantile(distance, 0.95)]))


def mahalanobis(offset: Floats, covariance: Floats) -> Floats:
    """Squared distance of each column in units of the covariance, shape (n,); along an axis without extent it is 0."""
    inverse = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
    return np.asarray(np.einsum("in,ij,jn->n", offset, inverse, offset))


def fit_slopes(frequency_mhz: Floats, power: Floats, background: Floats) -> Slopes:
    """Fit a straight line in log10 of the power to each spectrum in both bands.

    The line is fitted to the power itself, which may fall below zero after the subtraction, with the scatter that
    the fitted power has in this background: a fit to the logarithm would have to leave out what is not positive, and
    that would flatten weak spectra.

    Parameters
    ----------
    power, background
        Power with the background subtracted, and the mean power of that background, shape (signal, bin).
    """
    low = _fit_band(frequency_mhz, power, background, LOW_MHZ)
    high = _fit_band(frequency_mhz, power, background, HIGH_MHZ)
    return Slopes(low[0], high[0], low[1], high[1])


def _fit_band(
    frequency_mhz: Floats, power: Floats, background: Floats, band: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Slope and its standard deviation of each signal, by Gauss-Newton steps in (level, slope) of ln power."""
    inside = (frequency_mhz >= band[0]) & (frequency_mhz <= band[1])
    x = frequency_mhz[inside] - np.mean(band)
    values, noise = power[:, inside], background[:, inside]
    level = np.log(np.maximum(values.mean(axis=1), 1e-3 * noise.mean(axis=1) + 1e-300))
    slope = np.zeros_like(level)
    for _ in range(STEPS):
        line = level[:, None] + np.clip(slope, -STEEPEST, STEEPEST)[:, None] * x
        model = np.exp(line)
        # cross term of pulse and background, the background itself (half of it in each component of the field), and
        # a floor for what is not a straight line
        precision = model**2 / (model * noise + noise**2 / 2.0 + (FLOOR * model) ** 2)
        left = values / model - 1.0
        total = precision.sum(axis=1)
        centre = (precision @ x) / total
        around = x - centre[:, None]
        spread = np.sum(precision * around**2, axis=1)
        step = np.clip(np.sum(precision * around * left, axis=1) / spread, -LARGEST_STEP, LARGEST_STEP)
        rise = np.clip(np.sum(precision * left, axis=1) / total, -1.0, 1.0)
        slope = slope + step
        level = level + rise - step * centre
    sigma = spread**-0.5 / np.log(10.0)
    is_known = (sigma < LARGEST_SIGMA) & (np.abs(slope) < STEEPEST)
    return np.where(is_known, slope / np.log(10.0), np.nan), np.where(is_known, sigma, np.nan)
