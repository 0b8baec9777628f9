"""Apply C(nu) to a trace: from ADC units to volts at the antenna, with the error of the calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CalibrationCurve, statistical_errors, systematic_errors
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats

Complexes = NDArray[np.complex128]


@dataclass(frozen=True, repr=False)
class CalibratedTrace:
    """A trace in volts, in the time and in the frequency domain.

    Attributes
    ----------
    samples
        Shape (sample,), V at the antenna's output, band-limited to the channels of the curve.
    frequency_mhz
        FFT bins, shape (bin,), 0 to half the sampling rate.
    spectrum
        `numpy.fft.rfft` of `samples`, complex, shape (bin,), V; zero outside the band.
    c
        C at each bin, V per ADC unit, shape (bin,); 0 outside the band.
    channels_mhz, errors
        One standard deviation of ln C for each independent error on the channels of the curve, shapes (freq,) and
        (factor, freq). Between channels each is interpolated as C is.
    is_inside
        Which bins lie in the band of the curve, between channels that have a value, shape (bin,); what lies outside
        is not calibrated, and was set to 0.
    """

    samples: Floats
    sample_rate_mhz: float
    frequency_mhz: Floats
    spectrum: Complexes
    c: Floats
    channels_mhz: Floats
    errors: Floats
    is_inside: NDArray[np.bool_]

    def __repr__(self) -> str:
        """One line."""
        band = self.frequency_mhz[self.is_inside]
        ends = f"{band[0]:g}-{band[-1]:g} MHz" if band.size else "no channel"
        return f"<CalibratedTrace: {len(self.samples)} samples in V at {self.sample_rate_mhz:g} MHz, known in {ends}>"

    @property
    def factors(self) -> Floats:
        """The errors at each bin, shape (factor, bin); 0 outside the band."""
        rows = [np.interp(self.frequency_mhz, self.channels_mhz, error) for error in self.errors]
        return np.reshape(rows, (-1, self.frequency_mhz.size)) * self.is_inside

    @property
    def c_sigma(self) -> Floats:
        """Standard deviation of C at each bin, V per ADC unit, shape (bin,)."""
        return np.asarray(self.c * np.sqrt(np.sum(self.factors**2, axis=0)))

    def covariance(self) -> Floats:
        """Covariance of ln C between the bins inside the band, shape (inside, inside)."""
        inside = self.factors[:, self.is_inside]
        return np.asarray(inside.T @ inside)

    def sigma_of_energy(self) -> float:
        """Relative standard deviation of the energy sum |spectrum|^2 from the calibration alone."""
        power = np.abs(self.spectrum) ** 2
        change = [power @ np.interp(self.frequency_mhz, self.channels_mhz, error) for error in self.errors]
        return float(2.0 * np.linalg.norm(change) / power.sum())


def calibrate_trace(
    samples: Floats, sample_rate_mhz: float, curve: CalibrationCurve, budget: Budget | None = None
) -> CalibratedTrace:
    """Multiply the spectrum of a trace by C(nu), interpolated linearly to the FFT bins.

    The convention is that of NuRadioReco's stationGalacticCalibrator, which multiplies the Fourier transform by the
    curve interpolated linearly between channels. Its file holds zeros outside 30-80 MHz and so ramps over the
    channel beyond each edge; here a bin outside the band is 0 and `is_inside` says so. The relative calibration
    between antennas that it applies besides is not part of C.

    Parameters
    ----------
    samples
        Shape (sample,), ADC units, cleaned of interference.
    sample_rate_mhz
        200 for LOFAR.
    curve
        C(nu) in effect for the path of the trace, as `lbacal.effective` or a fit gives it.
    budget
        The systematic terms that the curve's covariance names.
    """
    values = np.asarray(samples)
    if values.dtype.kind not in "biuf":
        raise BadInputError("samples", "real numbers", values.dtype.name)
    if values.ndim != 1 or values.size < 2:
        raise BadInputError("samples", "two or more numbers in one row", f"shape {values.shape}")
    if not np.all(np.isfinite(values)):
        raise BadInputError("samples", "finite numbers", f"{np.sum(~np.isfinite(values))} NaN or infinite")
    if not sample_rate_mhz > 0:
        raise BadInputError("sample_rate_mhz", "MHz > 0", f"{sample_rate_mhz}")
    if curve.c is None:
        raise BadInputError(curve.name, "a curve that converged", curve.status)
    frequency_mhz = np.asarray(np.fft.rfftfreq(values.size, 1.0 / sample_rate_mhz), dtype=np.float64)
    channels = curve.frequency_mhz
    is_inside = np.interp(frequency_mhz, channels, curve.has_value.astype(float), 0.0, 0.0) == 1.0
    if not np.any(is_inside):
        band = f"{channels[0]:g} to {channels[-1]:g} MHz"
        bins = f"one every {frequency_mhz[1]:g} MHz up to {frequency_mhz[-1]:g} MHz"
        expected = f"FFT bins in the band of {curve.name}, {band}"
        raise BadInputError("samples", expected, f"{bins}: is the sampling rate in MHz, not in Hz or GHz?")
    c = np.where(is_inside, np.interp(frequency_mhz, channels, curve.filled(curve.c)), 0.0)
    errors = [curve.filled(error) for error in relative_errors(curve, budget)]
    spectrum = np.fft.rfft(values) * c
    return CalibratedTrace(
        np.fft.irfft(spectrum, values.size),
        sample_rate_mhz,
        frequency_mhz,
        spectrum,
        c,
        channels,
        np.reshape(errors, (-1, channels.size)),
        is_inside,
    )


def relative_errors(curve: CalibrationCurve, budget: Budget | None = None) -> list[Floats]:
    """The known errors of ln C, independent of each other, shape (freq,) each; NaN where C has no value.

    Each is fully correlated along frequency. Without the curve's covariance so are its standard deviations, and without
    the budget that the covariance names its systematic one: nearly so, because three noise constants and one level tie
    all channels together.
    """
    return [*statistical_errors(curve), *systematic_errors(curve, budget)]
