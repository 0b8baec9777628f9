"""What the lines of one path leave of its events along LST, and how lines and rest answer to changes of the sky.

Both answers are those of the fit with its weights held: a change of the power of every event moves slopes and
intercepts by one step, and what the lines do not take is left beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lbacal_core.calibration.lines import Lines, weigh_shared_noise
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener, solve_symmetric

SKY_HARMONICS = 8
"""P_sky and its changes have no more, to 0.005 %."""
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
    """What is left beside the lines of a path, along the harmonics of the sidereal day.

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


def move_lines(path: PathLines, basis: Floats, series: Floats) -> Floats:
    """How slopes and intercepts answer to each change of the sky, as the fit weighs events; shape (mode, 2 freq)."""
    of_sky, of_constant = path.of_sky, path.of_constant
    signal = path.slope * of_sky
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


def harmonics_at(lst_hours: Floats, most: int) -> Floats:
    """1, then cosines, then sines, of the sidereal day, shape (event, 1 + 2 most)."""
    angle = 2.0 * np.pi / 24.0 * np.outer(lst_hours, np.arange(1, most + 1))
    return np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)
