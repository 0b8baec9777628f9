"""One straight line per channel, P = s P_sky + b, fitted to the events of many paths at once.

This first half of the fit knows no signal chain. It reduces the spectra of a path, however many, to its 2 x freq
numbers (s, b) and their information matrix, without loss: with the weights held fixed, fitting the chain to these
equals fitting it to the spectra (`tests/lbacal_core/calibration/test_lines.py` does both).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.calibration.noise import NoiseLevels, estimate_noise_levels
from lbacal_core.calibration.normal_equations import solve_normal_equations
from lbacal_core.grids import Floats

PATHS_AT_ONCE = 6
"""Paths whose spectra of a year fit into a core's cache together: 6 x 900 x 51 numbers, 2.2 MB (4 and 8 are slower)."""

RIDGE = 1e-12
"""Where the sky hardly varies, slope and intercept of a channel are nearly one parameter."""


@dataclass(frozen=True)
class Lines:
    """Straight lines of paths, with their information matrices and noise levels.

    Attributes
    ----------
    slope, intercept
        s (recorded power per unit of P_sky) and b (ADC^2/Ohm/MHz), shape (path, freq).
    information
        Inverse covariance of (s, b), shape (path, 2 freq, 2 freq), all s first.
    levels
        The noise levels estimated on the way.
    """

    slope: Floats
    intercept: Floats
    information: Floats
    levels: NoiseLevels

    def power(self, sky_power: Floats) -> Floats:
        """The power on the lines, shape (path, event, freq), for P_sky, shape (event, freq)."""
        return self.slope[:, None, :] * sky_power + self.intercept[:, None, :]


def fit_lines(power: Floats, sky_power: Floats, relative_variance: Floats) -> Lines:
    """Fit the lines by generalised least squares with noise levels estimated from the data.

    The weights come from lines fitted without weights (right to 1 %), not from the recorded power, which would favour
    low readings.

    Parameters
    ----------
    power
        Recorded power, shape (path, event, freq), ADC^2/Ohm/MHz; any finite number where absent.
    sky_power
        P_sky, shape (event, freq).
    relative_variance
        Variance of the radiometer noise over that of the typical spectrum, shape (path, event); infinite where absent.
    """
    parts = [slice(k, k + PATHS_AT_ONCE) for k in range(0, power.shape[0], PATHS_AT_ONCE)]
    lines = [_fit_part(power[part], sky_power, relative_variance[part]) for part in parts]
    return Lines(
        np.concatenate([part.slope for part in lines]),
        np.concatenate([part.intercept for part in lines]),
        np.concatenate([part.information for part in lines]),
        NoiseLevels(
            np.concatenate([part.levels.radiometer for part in lines]),
            np.concatenate([part.levels.event_gain for part in lines]),
        ),
    )


def _fit_part(power: Floats, sky_power: Floats, relative_variance: Floats) -> Lines:
    slope, intercept = _unweighted_lines(power, sky_power, np.isfinite(relative_variance).astype(float))
    inverse_model = slope[:, None, :] * sky_power
    inverse_model += intercept[:, None, :]
    np.reciprocal(inverse_model, out=inverse_model)
    residual = power * inverse_model
    residual -= 1.0
    levels = estimate_noise_levels(residual, relative_variance, fitted_per_channel=2)
    step, information = _correlated_step(residual, sky_power, inverse_model, relative_variance, levels)
    return Lines(slope + step[:, 0], intercept + step[:, 1], information, levels)


def _unweighted_lines(power: Floats, sky_power: Floats, is_present: Floats) -> tuple[Floats, Floats]:
    """Ordinary least-squares lines of each channel: s and b, shape (path, freq)."""
    mean_sky = sky_power.mean(axis=0)
    sky = sky_power / mean_sky - 1.0
    w0 = np.maximum(is_present.sum(axis=1), 1.0)[:, None]
    w1, w2 = is_present @ sky, is_present @ sky**2
    y0 = _sum_events(is_present, power)
    y1 = _sum_events(is_present, power * sky)
    determinant = w0 * w2 - w1**2
    # a sky that varies by less than a millionth does not determine the slope
    has_spread = determinant > 1e-12 * w0**2
    tilt = np.where(has_spread, (w0 * y1 - w1 * y0) / np.where(has_spread, determinant, 1.0), 0.0)
    level = np.maximum((y0 - w1 * tilt) / w0, np.where(y0 > 0, 1e-6 * y0 / w0, 1.0))
    return tilt / mean_sky, level - tilt


def _correlated_step(
    residual: Floats, sky_power: Floats, inverse_model: Floats, relative_variance: Floats, levels: NoiseLevels
) -> tuple[Floats, Floats]:
    """One step to the generalised least-squares lines, shape (path, 2, freq), and their information matrix.

    The derivative of the relative model of an event by (s, b) is d = (P_sky, 1) / model in each channel. With
    C_i^-1 = V_i - c_i V_i 1 1^T V_i and V_i = diag(v) / k_i the information is the sum over events of d V d less that
    of c (d V 1) (d V 1)^T. Overwrites `inverse_model`.
    """
    paths, events, channels = residual.shape
    precision = 1.0 / relative_variance
    weight = levels.radiometer**-2
    shared = levels.shared_weight(relative_variance)
    common = precision * np.matmul(residual, weight[:, :, None])[:, :, 0]

    rows = np.empty((paths, events, 2 * channels))
    np.multiply(inverse_model, (np.sqrt(shared) * precision)[:, :, None], out=rows[:, :, channels:])
    np.multiply(rows[:, :, channels:], sky_power, out=rows[:, :, :channels])
    twice = np.concatenate([weight, weight], axis=1)
    information = np.matmul(rows.transpose(0, 2, 1), rows)
    information *= -twice[:, :, None] * twice[:, None, :]

    # what is left of the residual once the event's common gain has taken its share
    gradient = np.empty((paths, 2, channels))
    pull = residual - (shared * common)[:, :, None]
    pull *= inverse_model
    gradient[:, 1] = weight * _sum_events(precision, pull)
    pull *= sky_power
    gradient[:, 0] = weight * _sum_events(precision, pull)

    s, b = np.arange(channels), np.arange(channels, 2 * channels)
    square = np.multiply(inverse_model, inverse_model, out=inverse_model)
    information[:, b, b] += weight * _sum_events(precision, square)
    square *= sky_power
    cross = weight * _sum_events(precision, square)
    information[:, s, b] += cross
    information[:, b, s] += cross
    square *= sky_power
    information[:, s, s] += weight * _sum_events(precision, square)

    step = solve_normal_equations(information, gradient.reshape(paths, -1, 1), RIDGE)
    return step.reshape(paths, 2, channels), information


def _sum_events(weight: Floats, values: Floats) -> Floats:
    """Weighted sum over events, shape (path, freq)."""
    return np.asarray(np.matmul(weight[:, None, :], values)[:, 0, :])
