"""The chain test with the sky free within what is known of it: whether the model describes the data at all.

Two things must hold. The intercepts of all channels follow from three noise constants, b = N_LNA s + H q. And along LST
nothing is left beside the lines: the residual of an event, projected on a few smooth functions of frequency, follows no
harmonic of the sidereal day. Exchanged letters, a wrong clock or another antenna's pattern change what is left along
LST first, because a line in each channel absorbs most of what they do to the intercepts.

Where a sky is known to some precision, d ln P_sky = sum_k a_k m_k(LST, nu) with a_k ~ N(0, 1). It moves the measured
lines and what is left beside them by known vectors G (the response of the fit itself), so that both, as one vector r,
have the covariance V + G^T G (V: noise), and

    chi^2 = min over (N_LNA, q) of r^T (V + G^T G)^-1 r

has as many degrees of freedom as r has numbers, less three, and less those of the sky that the data determine, the
trace of G (V + G^T G)^-1 G^T. What the best sky departs from the one given, sum_k a_k^2, counts in full: a sky that is
off by one standard deviation in each mode costs one for each, a wrong clock hundreds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from lbacal_core.calibration.lines import Lines, weigh_shared_noise
from lbacal_core.calibration.mistakes import Mistake
from lbacal_core.calibration.normal_equations import scale_to_unit_diagonal, solve_normal_equations
from lbacal_core.grids import Floats
from lbacal_core.intercepts import Intercepts

MISFIT_PROBABILITY = 1e-6
"""A curve whose chi^2 is less probable than this is a misfit: of 2000 good ones 0.002 are."""
SKY_HARMONICS = 8
"""P_sky and its changes have no more, to 0.005 %."""
HARMONICS = 3
"""Harmonics of the sidereal day that are looked for beside the lines."""
DEGREES = 3
"""Legendre polynomials in frequency on which the residual of an event is projected."""
SMALLEST_LEFT = 0.1
"""A harmonic of which the lines absorb all but this share cannot be tested."""
SMALLEST_OF_LINES = 1e-3


@dataclass(frozen=True)
class SkyFreedom:
    """How far P_sky may differ from the one that is given.

    Attributes
    ----------
    modes
        By dipole, shape (mode, lst, freq), on a regular grid of the sidereal day that begins at 0 h: independent
        changes of ln P_sky, one standard deviation each.
    digest
        Hash of what they were made from.
    mistakes
        Named changes of P_sky that would put a mistaken input right, on the same grid.
    """

    modes: Mapping[str, Floats]
    digest: str
    mistakes: Sequence[Mistake] = ()

    def series(self, dipole: str) -> Floats:
        """Coefficients of `_harmonics` of the modes, shape (mode, harmonic, freq)."""
        return _series_of(self.modes[dipole])

    def mistake_series(self, dipole: str) -> Floats:
        """Coefficients of `_harmonics` of what data show of each mistake, shape (mistake, harmonic, freq)."""
        shown = [one.shown(dipole) for one in self.mistakes]
        return _series_of(np.reshape(shown, (-1, *self.modes[dipole].shape[1:])))


def _series_of(changes: Floats) -> Floats:
    terms = np.fft.rfft(changes, axis=1)[:, : SKY_HARMONICS + 1] / changes.shape[1]
    return np.concatenate([terms[:, :1].real, 2.0 * terms[:, 1:].real, -2.0 * terms[:, 1:].imag], axis=1)


@dataclass(frozen=True)
class ChainTest:
    """What the test finds in paths.

    Attributes
    ----------
    chi2, dof
        Chi^2 and its degrees of freedom, both shape (path,).
    gain
        Ln of the probability of the data without each mistake over that with it, shape (path, mistake).
    """

    chi2: Floats
    dof: Floats
    gain: Floats

    @property
    def per_dof(self) -> Floats:
        """Chi^2 per degree of freedom."""
        return np.asarray(self.chi2 / self.dof)

    @property
    def is_misfit(self) -> NDArray[np.bool_]:
        """Whether noise and the freedom of the sky cannot explain it."""
        return is_improbable(self.chi2, self.dof)


def is_improbable(chi2: Floats, dof: Floats | NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether chi^2 is larger than chance makes it."""
    return np.asarray(chi2_distribution.sf(chi2, dof) < MISFIT_PROBABILITY)


def run_chain_test(
    power: Floats,
    sky_power: Floats,
    relative_variance: Floats,
    lst_hours: Floats,
    lines: Lines,
    n: Floats,
    slope: Floats,
    terms: Intercepts,
    is_free: NDArray[np.bool_],
    freedom: SkyFreedom | None,
    dipole: str,
) -> ChainTest:
    """Test fitted paths, each by itself.

    Parameters
    ----------
    power, relative_variance
        As in `fit_lines`, shape (path, event, freq) and (path, event).
    sky_power, lst_hours
        Shape (event, freq) and (event,).
    lines
        Lines of these paths.
    n, slope
        Fitted noise in front, shape (path, r), and s, shape (path, freq). Noise and freedom are taken at these: a
        search for the N_LNA at which both are widest would always succeed.
    terms
        What each noise constant adds to an intercept.
    is_free
        Channels whose intercept is not tested, shape (path, freq).
    freedom, dipole
        The freedom of the sky, None where it is taken at its word; and the paths' dipole.
    """
    basis = _harmonics(lst_hours, SKY_HARMONICS)
    mistakes = 0 if freedom is None else len(freedom.mistakes)
    series = None
    if freedom is not None:
        series = np.concatenate([freedom.mistake_series(dipole), freedom.series(dipole)])
    found = []
    for p in range(power.shape[0]):
        is_present = np.isfinite(relative_variance[p])
        path = _Path.of(
            power[p, is_present], sky_power[is_present], relative_variance[p, is_present], lines.select(np.array([p]))
        )
        before = terms.before(n[p])
        found.append(_test_path(path, basis[is_present], before, slope[p], terms, is_free[p], series, mistakes))
    table = np.array(found, dtype=float).reshape(-1, 2 + mistakes)
    return ChainTest(table[:, 0], table[:, 1], table[:, 2:])


@dataclass(frozen=True)
class _Path:
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

    @classmethod
    def of(cls, power: Floats, sky: Floats, relative_variance: Floats, lines: Lines) -> _Path:
        """A path from its spectra that are present and its lines."""
        precision = 1.0 / relative_variance
        vectors = weigh_shared_noise(1.0 / lines.power(sky), precision[None], lines.levels, lines.shared)[0]
        return cls(
            power, sky, precision, vectors * np.sqrt(precision)[:, None, None],
            lines.levels.radiometer[0] ** -2, lines.slope[0], lines.intercept[0], lines.information[0],
        )  # fmt: skip


def _test_path(
    path: _Path,
    basis: Floats,
    before: Floats,
    slope: Floats,
    terms: Intercepts,
    is_free: NDArray[np.bool_],
    series: Floats | None,
    mistakes: int,
) -> tuple[float, ...]:
    """Chi^2, its degrees of freedom, and the gain of each mistake; the first of the series are those."""
    channels = path.slope.size
    model = path.slope * path.sky + path.intercept
    of_sky, of_constant = path.sky / model, 1.0 / model
    look = _look_beside(path.power / model - 1.0, of_sky, of_constant, basis)
    moved = np.zeros((0, 2 * channels)) if series is None else _move_lines(path, of_sky, of_constant, basis, series)
    beside = np.zeros((0, look.value.size))
    if series is not None:
        beside = look.respond(path.slope * of_sky, of_sky, of_constant, basis, series, moved)

    scaled, unit = scale_to_unit_diagonal(path.information[None])
    covariance = np.linalg.inv(scaled[0] + 1e-12 * np.eye(2 * channels)) * np.outer(unit[0], unit[0])
    tested = np.flatnonzero(~is_free)
    to_residual = np.concatenate([-np.diag(before), np.eye(channels)], axis=1)[tested]
    noise = to_residual @ covariance @ to_residual.T
    scale = np.sqrt(np.diag(noise))
    value = np.concatenate([(path.intercept - before * path.slope)[tested] / scale, look.value])
    response = np.concatenate([moved @ to_residual.T / scale, beside], axis=1)
    free = response[mistakes:]
    total = np.eye(value.size) + free.T @ free
    total[: tested.size, : tested.size] += noise / np.outer(scale, scale) - np.eye(tested.size)
    columns = np.zeros((value.size, len(terms.names)))
    forms = np.concatenate([terms.front * slope, terms.behind])
    columns[: tested.size] = forms.T[tested] / scale[:, None]
    whitener = np.linalg.cholesky(total)
    white: Floats = np.asarray(np.linalg.solve(whitener, np.column_stack([value, response.T])))
    white_columns = np.linalg.solve(whitener, columns)
    normal, target = white_columns.T @ white_columns, white_columns.T @ white
    left = white - white_columns @ solve_normal_equations(normal[None], target[None])[0]
    residual, without, of_sky_modes = left[:, 0], left[:, 1 : 1 + mistakes], left[:, 1 + mistakes :]
    gain = residual @ without - 0.5 * np.sum(without**2, axis=0)
    dof = value.size - len(terms.names) - float(np.sum(of_sky_modes**2))
    return float(residual @ residual), dof, *gain.tolist()


@dataclass(frozen=True)
class _Look:
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
        channels = signal.shape[1]
        seen = np.einsum("ej,eh,ef->jhf", self.directions, basis, signal, optimize=True)
        change = np.einsum("jhf,mhf,fk->mjk", seen, series, self.features, optimize=True)
        absorbed = np.einsum("jf,mf,fk->mjk", self.directions.T @ of_sky, moved[:, :channels], self.features)
        absorbed += np.einsum("jf,mf,fk->mjk", self.directions.T @ of_constant, moved[:, channels:], self.features)
        return np.asarray((change - absorbed).reshape(len(series), -1))


def _look_beside(residual: Floats, of_sky: Floats, of_constant: Floats, basis: Floats) -> _Look:
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
    factor = np.linalg.cholesky(scatter.T @ scatter / dof)
    # the mean of a quadratic form with a measured covariance exceeds that with the true one
    features = polynomials @ np.linalg.inv(factor).T * np.sqrt(max(dof - DEGREES - 1, 1) / dof)
    return _Look((directions.T @ (residual @ features)).ravel(), directions, features)


def _move_lines(path: _Path, of_sky: Floats, of_constant: Floats, basis: Floats, series: Floats) -> Floats:
    """How slopes and intercepts answer to each change of the sky, as the fit weighs events; shape (mode, 2 freq)."""
    modes, harmonics, channels = series.shape
    signal = path.slope * of_sky
    flat = series.transpose(2, 0, 1).reshape(channels, modes * harmonics)
    vectors = np.moveaxis(path.shared, 1, 0)
    common = [
        np.einsum("emh,eh->em", (signal * vector @ flat).reshape(-1, modes, harmonics), basis) for vector in vectors
    ]
    gradient = []
    for regressor in (of_sky, of_constant):
        own = (basis * path.precision[:, None]).T @ (signal * regressor)
        of_mode = path.weight * np.einsum("mhf,hf->mf", series, own)
        for amount, vector in zip(common, vectors, strict=True):
            of_mode -= amount.T @ (vector * regressor)
        gradient.append(of_mode)
    target = np.concatenate(gradient, axis=1).T
    return np.asarray(solve_normal_equations(path.information[None], target[None], 1e-12)[0].T)


def _harmonics(lst_hours: Floats, most: int) -> Floats:
    """1, then cosines, then sines, of the sidereal day, shape (event, 1 + 2 most)."""
    angle = 2.0 * np.pi / 24.0 * np.outer(lst_hours, np.arange(1, most + 1))
    return np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)
