"""One straight line per channel, P = s P_sky + b, fitted to the events of many paths at once.

This first half of the fit knows no signal chain. It reduces the spectra of a path, however many, to its 2 x freq
numbers (s, b) and their information matrix, without loss: with the weights held fixed, fitting the chain to these
equals fitting it to the spectra (`tests/lbacal_core/calibration/test_lines.py` does both).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.calibration.noise import NoiseLevels, estimate_noise_levels
from lbacal_core.grids import Floats

PATHS_AT_ONCE = 4
"""Paths whose spectra of a year fit into a core's cache together: 4 x 900 x 51 numbers, 1.5 MB."""


@dataclass(frozen=True)
class Lines:
    """Lines of paths with what the spectra say about them.

    Attributes
    ----------
    slope, intercept
        s (recorded power per unit of P_sky) and b (ADC^2/Ohm/MHz), shape (path, freq).
    information
        Inverse covariance of (s, b), shape (path, 2 freq, 2 freq), all s first.
    levels
        The noise levels estimated on the way.
    residual
        Relative deviations of the spectra from the lines, shape (path, event, freq); 0 where absent.
    """

    slope: Floats
    intercept: Floats
    information: Floats
    levels: NoiseLevels
    residual: Floats


def fit_lines(power: Floats, sky_power: Floats, excess: Floats) -> Lines:
    """Fit the lines by generalised least squares with noise levels estimated from the data.

    The weights come from lines fitted without weights (right to 1 %), not from the recorded power, which would favour
    low readings.

    Parameters
    ----------
    power
        Recorded power, shape (path, event, freq), ADC^2/Ohm/MHz; any finite number where absent.
    sky_power
        P_sky, shape (event, freq).
    excess
        Variance of the radiometer noise over that of the typical spectrum, shape (path, event); infinite where absent.
    """
    parts = range(0, power.shape[0], PATHS_AT_ONCE)
    lines = [_fit_part(power, sky_power, excess, slice(k, k + PATHS_AT_ONCE)) for k in parts]
    return Lines(
        np.concatenate([part.slope for part in lines]),
        np.concatenate([part.intercept for part in lines]),
        np.concatenate([part.information for part in lines]),
        NoiseLevels(
            np.concatenate([part.levels.radiometer for part in lines]),
            np.concatenate([part.levels.event_gain for part in lines]),
        ),
        np.concatenate([part.residual for part in lines]),
    )


def _fit_part(power: Floats, sky_power: Floats, excess: Floats, part: slice) -> Lines:
    power, excess = power[part], excess[part]
    is_present = np.isfinite(excess).astype(float)
    mean_sky = sky_power.mean(axis=0)
    sky = sky_power / mean_sky - 1.0
    level, tilt = _unweighted_lines(power, sky, is_present)
    mean_power = level
    tilt, level = tilt / mean_power, np.ones_like(level)

    inverse_model = 1.0 / (1.0 + tilt[:, None, :] * sky)
    residual = (power / mean_power[:, None, :] * inverse_model - 1.0) * is_present[:, :, None]
    levels = estimate_noise_levels(residual, excess, fitted_per_channel=2)
    step, information = _correlated_step(residual, sky, inverse_model, excess, levels)
    channels = sky_power.shape[1]
    change = step[:, None, :channels] + step[:, None, channels:] * sky
    residual -= change * inverse_model * is_present[:, :, None]
    level, tilt = level + step[:, :channels], tilt + step[:, channels:]
    return Lines(
        slope=tilt * mean_power / mean_sky,
        intercept=(level - tilt) * mean_power,
        information=_transform(information, _relative_from_lines(mean_power, mean_sky)),
        levels=levels,
        residual=residual,
    )


def _unweighted_lines(power: Floats, sky: Floats, is_present: Floats) -> tuple[Floats, Floats]:
    """Ordinary least-squares lines in (P_sky / mean - 1) of each channel: level and tilt, shape (path, freq)."""
    w0 = np.maximum(is_present.sum(axis=1), 1.0)[:, None]
    w1, w2 = is_present @ sky, is_present @ sky**2
    y0 = np.matmul(is_present[:, None, :], power)[:, 0, :]
    y1 = np.einsum("pe,ef,pef->pf", is_present, sky, power, optimize=False)
    determinant = w0 * w2 - w1**2
    # a sky that varies by less than a millionth says nothing about the slope
    has_spread = determinant > 1e-12 * w0**2
    tilt = np.where(has_spread, (w0 * y1 - w1 * y0) / np.where(has_spread, determinant, 1.0), 0.0)
    return np.maximum((y0 - w1 * tilt) / w0, 1e-6 * y0 / w0 + 1e-300), tilt


def _correlated_step(
    residual: Floats, sky: Floats, inverse_model: Floats, excess: Floats, levels: NoiseLevels
) -> tuple[Floats, Floats]:
    """One step to the generalised least-squares lines, and their information matrix (level first, then tilt)."""
    channels = sky.shape[1]
    weight = levels.channel_weight(excess)
    shared = levels.shared_weight(weight)
    # V_i times the derivative of the relative model by (level, tilt), one row an event
    weighted = np.empty((*residual.shape[:2], 2 * channels))
    np.multiply(weight, inverse_model, out=weighted[:, :, :channels])
    np.multiply(weighted[:, :, :channels], sky, out=weighted[:, :, channels:])
    common = np.einsum("pef,pef->pe", weight, residual)
    gradient = (weighted * np.concatenate([residual, residual], axis=2)).sum(axis=1)
    gradient -= np.matmul((shared * common)[:, None, :], weighted)[:, 0, :]

    scaled = weighted * np.sqrt(shared)[:, :, None]
    information = -np.matmul(scaled.transpose(0, 2, 1), scaled)
    own = weighted[:, :, :channels] * inverse_model
    at = np.arange(channels)
    information[:, at, at] += own.sum(axis=1)
    cross = np.einsum("pef,ef->pf", own, sky)
    information[:, at, channels + at] += cross
    information[:, channels + at, at] += cross
    information[:, channels + at, channels + at] += np.einsum("pef,ef->pf", own, sky**2)
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("pii->pi", information), 1e-300))
    ridge = 1e-14 * np.eye(2 * channels)
    normalised = information * scale[:, :, None] * scale[:, None, :] + ridge
    step = scale * np.linalg.solve(normalised, (scale * gradient)[:, :, None])[:, :, 0]
    return step, information


def _relative_from_lines(mean_power: Floats, mean_sky: Floats) -> Floats:
    """Derivative of (level, tilt) by (s, b) in each channel, shape (path, freq, 2, 2).

    level + tilt (P_sky / mean_sky - 1) = (s P_sky + b) / mean_power gives tilt = s mean_sky / mean_power and
    level = tilt + b / mean_power.
    """
    derivative = np.zeros((*mean_power.shape, 2, 2))
    derivative[..., 0, 0] = derivative[..., 1, 0] = mean_sky / mean_power
    derivative[..., 0, 1] = 1.0 / mean_power
    return derivative


def _transform(information: Floats, derivative: Floats) -> Floats:
    """Information about (s, b) from that about (level, tilt)."""
    paths, channels = derivative.shape[:2]
    blocks = information.reshape(paths, 2, channels, 2, channels)
    turned = np.einsum("pfai,pafbg,pgbj->pifjg", derivative, blocks, derivative, optimize=True)
    return np.ascontiguousarray(turned.reshape(paths, 2 * channels, 2 * channels))
