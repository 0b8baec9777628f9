"""One straight line per channel, P = s P_sky + b, fitted to the events of many paths at once.

This first half of the fit knows no signal chain. It reduces the spectra of a path, however many, to its 2 x freq
numbers (s, b) and their information matrix, without loss: with the weights held fixed, fitting the chain to these
equals fitting it to the spectra (`tests/lbacal_core/calibration/test_lines.py` does both).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.calibration.gain_memory import add_variance, find_variance_along
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener, solve_symmetric
from lbacal_core.simulation.prior import SKY_HARMONICS

# The noise of background spectra: independent in each channel, plus a few vectors that an event shares along nu.
#
# The relative deviation of event i from its model has the covariance
#
# C_i = k_i diag(sigma_f^2) + sum_k v_k v_k^T,
#
# radiometer noise (k_i: its variance against that of the typical number of blocks) and at most three vectors. A gain
# that fluctuates from event to event behind everything is a vector flat in frequency; in front of N_RCU it has the
# share of the sky and of N_LNA in the recorded power; a resonance that moves adds d ln G/d nu times that share. Such
# vectors span a few dimensions; their covariance in these, and one more vector if it stands out, are estimated from the
# data.

MOST_VECTORS = 3
"""More would describe effects that are looked for."""
ROUNDS = 3
"""Rounds between the radiometer noise and the basis, which is weighted by it."""
SMALLEST, SMALLEST_SHARE, SMALLEST_OF_TYPICAL = 1e-12, 0.05, 0.1
"""Floors of a variance, of its share outside the basis, and of a channel's variance over the typical channel's."""
EXCESS_SCATTER = 1.5
"""Scatter over that of the channels beside it; 60 events know a scatter to 9 %."""
BESIDE = 3
"""Channels on either side."""
LOUD = 3.0
"""Power over that of the louder channel next to it; weaker lines stand out of the chain."""
SMALLEST_ANGLE = 1e-3
"""Angle of a vector to those before it below which only rounding tells them apart."""
CHANNELS_PER_VECTOR = 8
"""Channels that each vector needs."""
SEEN = 4.0
"""Standard deviations of its estimate beyond which the variance along a vector counts."""
OUTSTANDING = 1.5
"""Factor above the largest eigenvalue of noise (Marchenko & Pastur 1967) beyond which data have a vector of their
own."""


@dataclass(frozen=True)
class NoiseLevels:
    """Levels of the relative noise of paths.

    Attributes
    ----------
    radiometer
        Shape (path, freq), standard deviation at the typical number of blocks.
    vectors
        v_k, shape (path, vector, freq), orthogonal in units of the radiometer noise; 0 where there is none.
    """

    radiometer: Floats
    vectors: Floats

    @property
    def of_band(self) -> Floats:
        """Standard deviation of the mean over all channels of an event, shape (path,)."""
        own = np.mean(self.radiometer**2, axis=-1) / self.radiometer.shape[-1]
        return np.asarray(np.sqrt(np.sum(self.vectors.mean(axis=-1) ** 2, axis=1) + own))


def estimate_noise_levels(
    residual: Floats, relative_variance: Floats, fitted_per_channel: int, seeds: Floats
) -> NoiseLevels:
    """Estimate the levels from relative residuals of a fit that is linear in each channel.

    Parameters
    ----------
    residual
        Relative residuals, shape (path, event, freq); any finite number where absent.
    relative_variance
        k_i, shape (path, event); infinite where absent.
    fitted_per_channel
        Parameters that the fit spent on each channel.
    seeds
        Vectors that an event may share, shape (path, seed, freq).
    """
    seeds = seeds[:, : max(1, residual.shape[2] // CHANNELS_PER_VECTOR)]
    precision = 1.0 / relative_variance
    events = np.maximum(np.isfinite(relative_variance).sum(axis=1), 1)
    dof = np.maximum(events - fitted_per_channel, 1)
    weighted = residual * precision[:, :, None]
    covariance = np.matmul(weighted.transpose(0, 2, 1), residual) / dof[:, None, None]
    variance = np.maximum(np.einsum("pff->pf", covariance), SMALLEST)
    for number in range(ROUNDS):
        sigma = np.sqrt(variance)
        white = covariance / (sigma[:, :, None] * sigma[:, None, :])
        basis = orthonormal(seeds / sigma[:, None]).transpose(0, 2, 1)
        rest = _beside(white, basis)
        own = _outstanding(rest, events / residual.shape[2], is_sought=number == ROUNDS - 1)
        basis = np.concatenate([basis, own[:, :, None]], axis=2)
        # What lies outside the basis is radiometer noise; the basis has taken its leverage of it.
        left = np.einsum("pff->pf", rest) - own * np.einsum("pfg,pg->pf", rest, own)
        share = 1.0 - np.sum(basis**2, axis=2)
        variance = np.maximum(variance * left / np.maximum(share, SMALLEST_SHARE), SMALLEST)
        variance = np.maximum(variance, SMALLEST_OF_TYPICAL * np.median(variance, axis=1, keepdims=True))
    white = covariance / (sigma[:, :, None] * sigma[:, None, :])
    inside = np.matmul(basis.transpose(0, 2, 1), np.matmul(white, basis)) - np.eye(basis.shape[2])
    values, turned = np.linalg.eigh(inside)
    strongest = slice(None, -MOST_VECTORS - 1, -1)
    size = np.where(values[:, strongest] > SEEN * np.sqrt(2.0 / events)[:, None], values[:, strongest], 0.0)
    vectors = np.matmul(basis, turned[:, :, strongest]).transpose(0, 2, 1) * np.sqrt(size)[:, :, None] * sigma[:, None]
    # An event of more blocks counts more in the covariance than the gain that it shares does.
    shared = np.sum(precision, axis=1) / events
    return NoiseLevels(sigma, vectors / np.sqrt(np.maximum(shared, 1e-300))[:, None, None])


def orthonormal(vectors: Floats) -> Floats:
    """An orthonormal basis of vectors, shape (..., vector, freq); 0 for one that is a combination of those before."""
    turned, corner = np.linalg.qr(np.swapaxes(vectors, -1, -2))
    own = np.abs(np.diagonal(corner, axis1=-2, axis2=-1))
    is_new = own > SMALLEST_ANGLE * np.linalg.norm(vectors, axis=-1)[..., : own.shape[-1]]
    return np.asarray(np.swapaxes(turned, -1, -2) * is_new[..., None])


def _beside(white: Floats, basis: Floats) -> Floats:
    """The part of covariances that lies outside a basis, shape (path, freq, freq)."""
    along = np.matmul(basis.transpose(0, 2, 1), white)
    inside = np.matmul(basis, along)
    both = np.matmul(np.matmul(inside, basis), basis.transpose(0, 2, 1))
    return np.asarray(white - inside - inside.transpose(0, 2, 1) + both)


def _outstanding(rest: Floats, events_per_channel: Floats, *, is_sought: bool) -> Floats:
    """The strongest vector of covariances, shape (path, freq); 0 where noise has as strong a one, or none is sought."""
    if not is_sought:
        return np.zeros(rest.shape[:2])
    values, vectors = np.linalg.eigh(rest)
    largest_of_noise = (1.0 + events_per_channel**-0.5) ** 2
    return np.asarray(vectors[:, :, -1] * (values[:, -1] > OUTSTANDING * largest_of_noise)[:, None])


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
        """Make the forms of an instrument."""
        slope = scipy.interpolate.CubicSpline(frequency_mhz, np.log(antenna_gain))(frequency_mhz, 1)
        return cls(np.asarray(slope), receiver_gain)


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
        """Select some of the paths by their rows."""
        levels = NoiseLevels(self.levels.radiometer[paths], self.levels.vectors[paths])
        shared = SharedNoise(self.shared.constant[paths], self.shared.behind[paths])
        return Lines(self.slope[paths], self.intercept[paths], self.information[paths], levels, shared)

    def weigh(self, factor: float) -> Lines:
        """The same with another multiple of the information."""
        return self if factor == 1.0 else replace(self, information=factor * self.information)

    def exchange(self, at: NDArray[np.intp], part: Lines) -> Lines:
        """The lines with those of some paths exchanged."""

        def put(before: Floats, now: Floats) -> Floats:
            found = before.copy()
            found[at] = now
            return found

        return Lines(
            put(self.slope, part.slope), put(self.intercept, part.intercept), put(self.information, part.information),
            NoiseLevels(*map(put, vars(self.levels).values(), vars(part.levels).values())),
            SharedNoise(*map(put, vars(self.shared).values(), vars(part.shared).values())),
        )  # fmt: skip

    def power(self, sky_power: Floats) -> Floats:
        """The power on the lines, shape (path, event, freq), for P_sky, shape (event, freq)."""
        return self.slope[:, None, :] * sky_power + self.intercept[:, None, :]


def fit_lines(
    power: Floats,
    sky_power: Floats,
    relative_variance: Floats,
    chain: ChainForms | None = None,
    time_unix: Floats | None = None,
) -> Lines:
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
    time_unix
        Shape (event,); errors then cover gains that last for hours (`gain_memory`).
    """
    chain = chain or ChainForms(np.zeros(power.shape[2]), np.ones(power.shape[2]))
    parts = [slice(k, k + PATHS_AT_ONCE) for k in range(0, power.shape[0], PATHS_AT_ONCE)]
    lines = [_fit_part(power[part], sky_power, relative_variance[part], chain, time_unix) for part in parts]
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


def _fit_part(
    power: Floats, sky_power: Floats, relative_variance: Floats, chain: ChainForms, time_unix: Floats | None
) -> Lines:
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
    level = slope * mean_sky + intercept
    wider = None if time_unix is None else _find_wider(residual, sky_power, relative_variance, levels, time_unix)
    gradient, information = _weigh_events(residual, sky_power, inverse_model, relative_variance, levels, shared)
    step = _solve(information, gradient)
    slope, intercept = slope + step[:, 0], intercept + step[:, 1]
    if wider is not None:
        along = level[:, None] * levels.vectors
        directions = np.concatenate([along / mean_sky, -along], axis=2)
        for k in np.flatnonzero(wider.any(axis=0)).tolist():
            information = add_variance(information, directions[:, k], wider[:, k])
    disturbed = is_disturbed(levels.radiometer, level, slope)
    return Lines(slope, intercept, free_intercepts(information, disturbed), levels, shared)


def _find_wider(
    residual: Floats, sky_power: Floats, relative_variance: Floats, levels: NoiseLevels, time_unix: Floats
) -> Floats:
    """Variance by gains that last of a slope times the mean sky over the power, shape (path, vector).

    In units of the vectors of the noise; what a slope takes is taken from its intercept.
    """
    weighted = levels.vectors / levels.radiometer[:, None] ** 2
    size = np.sum(weighted * levels.vectors, axis=2)
    amount = np.matmul(residual, weighted.transpose(0, 2, 1))
    amount[~np.isfinite(relative_variance)] = np.nan
    course = (sky_power / sky_power.mean(axis=0)).mean(axis=1)
    wider, at = np.zeros(size.shape), np.nonzero(size > 0)
    wider[at] = find_variance_along(amount.transpose(0, 2, 1)[at], course, time_unix)
    return np.asarray(wider * (1.0 + size) / np.where(size > 0, size, 1.0))


def continue_lines(lines: Lines, power: Floats, sky_power: Floats, relative_variance: Floats) -> Lines:
    """The lines with some events more, at the noise levels that they have; parameters as in `fit_lines`."""
    inverse_model = 1.0 / lines.power(sky_power)
    residual = np.where(np.isfinite(relative_variance)[:, :, None], power * inverse_model - 1.0, 0.0)
    gradient, more = _weigh_events(residual, sky_power, inverse_model, relative_variance, lines.levels, lines.shared)
    information = lines.information + more
    step = _solve(information, gradient)
    disturbed = is_disturbed(lines.levels.radiometer, lines.power(sky_power).mean(axis=1), lines.slope)
    information = free_intercepts(information, disturbed)
    return replace(
        lines, slope=lines.slope + step[:, 0], intercept=lines.intercept + step[:, 1], information=information
    )


def is_disturbed(radiometer: Floats, level: Floats, slope: Floats) -> NDArray[np.bool_]:
    """Channels with interference that comes and goes, by their scatter, or is strong, by their power, (path, freq).

    Strong lines bend the chain so far that none stands out of it. A channel is loud by itself and over its slope: one
    by a resonance has a large slope, too, and one at the end of the band little power.
    """
    padded = np.pad(radiometer, ((0, 0), (BESIDE, BESIDE)), mode="reflect")
    typical = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1, axis=1), axis=2)
    is_loud = np.ones(level.shape, dtype=bool)
    for one in (level, level / np.maximum(slope, 1e-300)):
        beside = np.pad(one, ((0, 0), (1, 1)), mode="reflect")
        is_loud &= one > LOUD * np.maximum(beside[:, :-2], beside[:, 2:])
    return np.asarray(is_loud | (radiometer > EXCESS_SCATTER * typical))


def find_free(information: Floats) -> NDArray[np.bool_]:
    """Channels whose intercepts say nothing, shape (path, freq)."""
    return np.asarray(np.einsum("pii->pi", information)[:, information.shape[1] // 2 :] == 0.0)


def free_intercepts(information: Floats, is_free: NDArray[np.bool_]) -> Floats:
    """Information about lines once the intercepts of some channels say nothing, shape (path, 2 freq, 2 freq).

    Interference adds to them, and slopes are right where it does not follow the sky.
    """
    information = information.copy()
    for path in np.flatnonzero(is_free.any(axis=1)).tolist():
        whole, at = information[path], is_free.shape[1] + np.flatnonzero(is_free[path])
        side = whole[:, at]
        left = whole - side @ solve_symmetric(whole[np.ix_(at, at)], side.T)
        left[at] = left[:, at] = 0.0
        information[path] = left
    return information


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


# What the lines of one path leave of its events along LST, and how lines and rest answer to changes of the sky.
#
# Both answers are those of the fit with its weights held: a change of the power of every event moves slopes and
# intercepts by one step, and what the lines do not take is left beside them.

HARMONICS = 3
"""Harmonics of the sidereal day that are looked for beside the lines."""
DEGREES = 3
"""Legendre polynomials in frequency on which the residual of an event is projected."""
SMALLEST_LEFT = 0.1
"""A harmonic of which the lines absorb all but this share cannot be tested."""
SMALLEST_OF_LINES = 1e-3
ROUNDING = 1e-13
"""A harmonic of a change of the sky that is weaker than this share of the strongest is rounding."""


@dataclass(frozen=True)
class PathLines:
    """One path: spectra (event, freq), precision (event,), weight and lines (freq,), information.

    `shared` is what an event shares along frequency, shape (event, vector, freq): C_i^-1 is diag(weight) times the
    precision, less the sum of the outer products of these vectors.
    """

    power: Floats
    sky: Floats
    precision: Floats
    shared: Floats
    weight: Floats
    slope: Floats
    intercept: Floats
    information: Floats

    @cached_property
    def model(self) -> Floats:
        """The power on the lines, shape (event, freq)."""
        return self.slope * self.sky + self.intercept

    @cached_property
    def of_sky(self) -> Floats:
        """The relative change of the power by a slope, shape (event, freq)."""
        return self.sky / self.model

    @cached_property
    def of_constant(self) -> Floats:
        """The relative change of the power by an intercept, shape (event, freq)."""
        return 1.0 / self.model

    @classmethod
    def of(cls, power: Floats, sky: Floats, relative_variance: Floats, lines: Lines) -> PathLines:
        """A path from its spectra that are present and its lines."""
        precision = 1.0 / relative_variance
        vectors = weigh_shared_noise(1.0 / lines.power(sky), precision[None], lines.levels, lines.shared)[0]
        return cls(
            power, sky, precision, vectors * np.sqrt(precision)[:, None, None],
            lines.levels.radiometer[0] ** -2, lines.slope[0], lines.intercept[0], lines.information[0],
        )  # fmt: skip


@dataclass(frozen=True)
class Look:
    """Residuals of the lines of a path along the harmonics of the sidereal day.

    Attributes
    ----------
    value
        Amplitudes in standard deviations, shape (direction x degree,).
    directions
        Orthonormal functions of LST that the lines do not absorb, shape (event, direction).
    features
        Functions of frequency, each in units of its standard deviation, shape (freq, degree).
    """

    value: Floats
    directions: Floats
    features: Floats

    def respond(
        self, signal: Floats, of_sky: Floats, of_constant: Floats, basis: Floats, series: Floats, moved: Floats
    ) -> Floats:
        """The amplitudes that each change of the sky makes, shape (mode, direction x degree)."""
        channels, numbers = signal.shape[1], self.value.size
        both = self.directions[:, :, None] * basis[:, None, :]
        seen = (both.reshape(len(signal), -1).T @ signal).reshape(*both.shape[1:], channels)
        weights = seen.transpose(1, 2, 0)[..., None] * self.features[:, None, :]
        change = series.reshape(len(series), -1) @ weights.reshape(-1, numbers)
        for at, regressor in ((slice(channels), of_sky), (slice(channels, None), of_constant)):
            taken = (self.directions.T @ regressor).T[:, :, None] * self.features[:, None, :]
            change -= moved[:, at] @ taken.reshape(channels, numbers)
        return np.asarray(change)


def look_beside(residual: Floats, of_sky: Floats, of_constant: Floats, basis: Floats) -> Look:
    """Project the residuals of a path's events; shape (event, freq) each.

    The scatter of the projections from event to event is measured, and with it gains of any shape along frequency.
    """
    events, channels = residual.shape
    polynomials = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, channels), DEGREES - 1) / channels
    projected = residual @ polynomials
    of_lines = np.concatenate([of_sky[:, :: channels // 4], of_constant[:, :: channels // 4]], axis=1)
    axes, size, _ = np.linalg.svd(of_lines / np.linalg.norm(of_lines, axis=0), full_matrices=False)
    axes = axes[:, size > SMALLEST_OF_LINES * size[0]]
    waves = basis[:, 1 : HARMONICS + 1], basis[:, SKY_HARMONICS + 1 : SKY_HARMONICS + HARMONICS + 1]
    left = np.concatenate(waves, axis=1)
    left = left - axes @ (axes.T @ left)
    directions, size, _ = np.linalg.svd(left, full_matrices=False)
    directions = directions[:, size > SMALLEST_LEFT * np.sqrt(events / 2.0)]
    amplitude = directions.T @ projected
    scatter = projected - directions @ amplitude
    scatter -= axes @ (axes.T @ scatter)
    dof = events - directions.shape[1] - axes.shape[1]
    # the mean of a quadratic form with a measured covariance exceeds that with the true one
    features = polynomials @ find_whitener(scatter.T @ scatter / dof).T * np.sqrt(max(dof - DEGREES - 1, 1) / dof)
    return Look((directions.T @ (residual @ features)).ravel(), directions, features)


def move_lines(path: PathLines, slope: Floats, basis: Floats, series: Floats) -> Floats:
    """How slopes and intercepts answer to each change of a sky with these slopes, as the fit weighs events.

    Shape (freq,) and (mode, 2 freq).
    """
    of_sky, of_constant = path.of_sky, path.of_constant
    signal = slope * of_sky
    # most modes are one harmonic or a few: the others are rounding
    mode_of, harmonic_of = np.nonzero(np.abs(series).max(axis=2) > ROUNDING * np.abs(series).max(initial=0.0))
    flat, waves = series[mode_of, harmonic_of].T, basis[:, harmonic_of]
    moving, first = np.unique(mode_of, return_index=True)
    vectors = np.moveaxis(path.shared, 1, 0)
    common = [np.add.reduceat((signal * vector @ flat) * waves, first, axis=1) for vector in vectors]
    gradient = []
    for regressor in (of_sky, of_constant):
        own = (basis * path.precision[:, None]).T @ (signal * regressor)
        change = path.weight * np.einsum("mhf,hf->mf", series, own)
        for amount, vector in zip(common, vectors, strict=True):
            change[moving] -= amount.T @ (vector * regressor)
        gradient.append(change)
    return _solve_lines(path, gradient)


def move_lines_by(path: PathLines, change: Floats) -> Floats:
    """The same for relative changes of the power of each event, shape (change, event, freq)."""
    common = np.einsum("kef,evf->kev", change, path.shared, optimize=True)
    gradient = []
    for regressor in (path.of_sky, path.of_constant):
        own = path.weight * np.einsum("kef,ef->kf", change, regressor * path.precision[:, None])
        shared = np.einsum("kev,evf->kf", common, path.shared * regressor[:, None], optimize=True)
        gradient.append(own - shared)
    return _solve_lines(path, gradient)


def _solve_lines(path: PathLines, gradient: Sequence[Floats]) -> Floats:
    """The step of the lines by the gradient along slopes and intercepts, shape (change, freq) each."""
    target = np.concatenate(gradient, axis=1).T
    return solve_symmetric(path.information, target).T
