"""One straight line per channel, P = s P_sky + b, fitted to the events of many paths at once.

This first half of the fit knows no signal chain. It reduces the spectra of a path, however many, to its 2 x freq
numbers (s, b) and their information matrix, without loss: with the weights held fixed, fitting the chain to these
equals fitting it to the spectra (`tests/lbacal_core/calibration/test_lines.py` does both).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.noise import NoiseLevels, estimate_noise_levels, slope_of_gain
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener, solve_symmetric

PATHS_AT_ONCE = 6
"""Paths whose spectra of a year fit into a core's cache together: 6 x 900 x 51 numbers, 2.2 MB (4 and 8 are slower)."""

SEEDS_PRIOR = 1e-4
"""Where nothing is added behind, gains in front and behind are one."""


@dataclass(frozen=True)
class ChainForms:
    """How the chain acts along frequency, by which an event's gain may fluctuate.

    Attributes
    ----------
    antenna_slope
        d ln G_ant / d nu, shape (freq,): the form of a resonance that moves.
    receiver_gain
        G_RCU, shape (freq,): what multiplies N_RCU.
    """

    antenna_slope: Floats
    receiver_gain: Floats

    @classmethod
    def of(cls, frequency_mhz: Floats, antenna_gain: Floats, receiver_gain: Floats) -> ChainForms:
        """The forms of an instrument."""
        return cls(slope_of_gain(frequency_mhz, antenna_gain), receiver_gain)


@dataclass(frozen=True)
class SharedNoise:
    """The vectors of `NoiseLevels` at each event: v_k - a_k / P, because the share of the sky changes with LST.

    Attributes
    ----------
    constant, behind
        v_k where nothing is added behind, and a_k, shape (path, vector, freq).
    """

    constant: Floats
    behind: Floats

    @classmethod
    def of(cls, levels: NoiseLevels, seeds: Floats, behind: Floats, chain: ChainForms) -> SharedNoise:
        """Split the vectors into the gains in front of N_RCU, which act on 1 - behind / P, and the rest."""
        normal = np.matmul(seeds, seeds.transpose(0, 2, 1))
        amount = solve_symmetric(normal, np.matmul(seeds, levels.vectors.transpose(0, 2, 1)), prior=SEEDS_PRIOR)
        gain = amount[:, 1, :, None] + amount[:, 2, :, None] * chain.antenna_slope
        rest = levels.vectors - np.matmul(amount.transpose(0, 2, 1), seeds)
        return cls(amount[:, 0, :, None] + gain + rest, gain * behind[:, None])


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
    shared
        What each event shares along frequency.
    """

    slope: Floats
    intercept: Floats
    information: Floats
    levels: NoiseLevels
    shared: SharedNoise

    def select(self, paths: NDArray[np.intp]) -> Lines:
        """Some of the paths."""
        levels = NoiseLevels(self.levels.radiometer[paths], self.levels.vectors[paths])
        shared = SharedNoise(self.shared.constant[paths], self.shared.behind[paths])
        return Lines(self.slope[paths], self.intercept[paths], self.information[paths], levels, shared)

    def power(self, sky_power: Floats) -> Floats:
        """The power on the lines, shape (path, event, freq), for P_sky, shape (event, freq)."""
        return self.slope[:, None, :] * sky_power + self.intercept[:, None, :]


def fit_lines(power: Floats, sky_power: Floats, relative_variance: Floats, chain: ChainForms | None = None) -> Lines:
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
    chain
        The form of the chain along frequency; None where it is not known, such as for an LST curve.
    """
    chain = chain or ChainForms(np.zeros(power.shape[2]), np.ones(power.shape[2]))
    parts = [slice(k, k + PATHS_AT_ONCE) for k in range(0, power.shape[0], PATHS_AT_ONCE)]
    lines = [_fit_part(power[part], sky_power, relative_variance[part], chain) for part in parts]
    return Lines(
        np.concatenate([part.slope for part in lines]),
        np.concatenate([part.intercept for part in lines]),
        np.concatenate([part.information for part in lines]),
        NoiseLevels(
            np.concatenate([part.levels.radiometer for part in lines]),
            np.concatenate([part.levels.vectors for part in lines]),
        ),
        SharedNoise(
            np.concatenate([part.shared.constant for part in lines]),
            np.concatenate([part.shared.behind for part in lines]),
        ),
    )


def _fit_part(power: Floats, sky_power: Floats, relative_variance: Floats, chain: ChainForms) -> Lines:
    slope, intercept = _unweighted_lines(power, sky_power, np.isfinite(relative_variance).astype(float))
    mean_sky = sky_power.mean(axis=0)
    behind = _behind(slope, intercept, mean_sky, chain)
    front = 1.0 - behind / (slope * mean_sky + intercept)
    seeds = np.stack([np.ones_like(front), front, front * chain.antenna_slope], axis=1)
    inverse_model = slope[:, None, :] * sky_power
    inverse_model += intercept[:, None, :]
    np.reciprocal(inverse_model, out=inverse_model)
    residual = power * inverse_model
    residual -= 1.0
    levels = estimate_noise_levels(residual, relative_variance, 2, seeds)
    shared = SharedNoise.of(levels, seeds, behind, chain)
    gradient, information = _weigh_events(residual, sky_power, inverse_model, relative_variance, levels, shared)
    step = _solve(information, gradient)
    return Lines(slope + step[:, 0], intercept + step[:, 1], information, levels, shared)


def continue_lines(lines: Lines, power: Floats, sky_power: Floats, relative_variance: Floats) -> Lines:
    """The lines with some events more, at the noise levels that they have; parameters as in `fit_lines`."""
    inverse_model = 1.0 / lines.power(sky_power)
    residual = np.where(np.isfinite(relative_variance)[:, :, None], power * inverse_model - 1.0, 0.0)
    gradient, more = _weigh_events(residual, sky_power, inverse_model, relative_variance, lines.levels, lines.shared)
    information = lines.information + more
    step = _solve(information, gradient)
    return replace(
        lines, slope=lines.slope + step[:, 0], intercept=lines.intercept + step[:, 1], information=information
    )


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


def _behind(slope: Floats, intercept: Floats, mean_sky: Floats, chain: ChainForms) -> Floats:
    """What the chain adds behind the place of a gain in front of N_RCU, shape (path, freq): N_RCU S G_RCU + N_ADC.

    From the intercepts, b = N_LNA s + N_RCU S G_RCU + N_ADC, weighed with the power.
    """
    power = slope * mean_sky + intercept
    added = np.broadcast_to(np.stack([chain.receiver_gain, np.ones_like(mean_sky)]), (len(slope), 2, mean_sky.size))
    columns = np.concatenate([slope[:, None], added], axis=1) / power[:, None]
    normal = np.matmul(columns, columns.transpose(0, 2, 1))
    levels = solve_symmetric(normal, np.matmul(columns, (intercept / power)[:, :, None]))
    return np.asarray(np.clip(np.matmul(levels[:, 1:].transpose(0, 2, 1), added)[:, 0], 0.0, power))


def _weigh_events(
    residual: Floats,
    sky_power: Floats,
    inverse_model: Floats,
    relative_variance: Floats,
    levels: NoiseLevels,
    noise: SharedNoise,
) -> tuple[Floats, Floats]:
    """The gradient of -chi^2 / 2 of some events by (s, b), shape (path, 2, freq), and their information matrix.

    The derivative of the relative model of an event by (s, b) is d = (P_sky, 1) / model in each channel. With the
    vectors B_i of an event, V_i = diag(sigma^-2) / k_i and C_i^-1 = V_i - V_i B_i^T (1 + B_i V_i B_i^T)^-1 B_i V_i
    (Woodbury) the information is the sum over events of d V d less that of the second term. Overwrites
    `inverse_model`.
    """
    paths, events, channels = residual.shape
    precision = 1.0 / relative_variance
    weight = levels.radiometer**-2
    weighted = weigh_shared_noise(inverse_model, precision, levels, noise)
    common = np.matmul(weighted, residual[..., None])

    information = np.zeros((paths, 2 * channels, 2 * channels))
    # what is left of the residual once what the event shares has taken its part
    pull = residual - np.matmul(weighted.transpose(0, 1, 3, 2), common)[..., 0] / weight[:, None]
    weighted *= inverse_model[:, :, None]
    weighted *= np.sqrt(precision)[:, :, None, None]
    rows = np.empty((paths, events, 2 * channels))
    for k in range(weighted.shape[2]):
        rows[:, :, channels:] = weighted[:, :, k]
        np.multiply(weighted[:, :, k], sky_power, out=rows[:, :, :channels])
        information -= np.matmul(rows.transpose(0, 2, 1), rows)

    gradient = np.empty((paths, 2, channels))
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

    return gradient, information


def _solve(information: Floats, gradient: Floats) -> Floats:
    """The step to the generalised least-squares lines, shape (path, 2, freq)."""
    step = solve_symmetric(information, gradient.reshape(len(gradient), -1, 1))
    return step.reshape(gradient.shape)


def weigh_shared_noise(inverse_model: Floats, precision: Floats, levels: NoiseLevels, noise: SharedNoise) -> Floats:
    """The second term of C_i^-1 as vectors u_k, shape (path, event, vector, freq): V_i - sum_k u_k u_k^T / k_i.

    Parameters
    ----------
    inverse_model
        1 / P of the lines, shape (path, event, freq).
    precision
        1 / k_i, shape (path, event).
    """
    is_there = np.any(levels.vectors != 0, axis=(0, 2))
    vectors = noise.constant[:, None, is_there] - noise.behind[:, None, is_there] * inverse_model[:, :, None]
    weighted = vectors * (levels.radiometer**-2)[:, None, None]
    size = np.matmul(weighted, vectors.transpose(0, 1, 3, 2)) * precision[:, :, None, None]
    # Each row of the root of the inverse makes one vector of the event.
    root = find_whitener(size + np.eye(size.shape[-1])) * np.sqrt(precision)[:, :, None, None]
    return np.asarray(np.matmul(root, weighted))


def _sum_events(weight: Floats, values: Floats) -> Floats:
    """Weighted sum over events, shape (path, freq)."""
    return np.asarray(np.matmul(weight[:, None, :], values)[:, 0, :])
