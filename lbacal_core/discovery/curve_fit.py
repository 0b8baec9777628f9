"""Fits of sets of causes to one LST curve: sizes and an offset a dipole, under the covariance of the points.

The covariance is the point noise, with what the dipoles share, and for the package's own sky the spread of sky and
antenna models. Two skies and one antenna beside the default do not tell the shape of the next model's difference, only
its size: so at each harmonic of the sidereal day the difference has the variance of those known and any phase, and the
dipoles differ independently (those known differ alike, which makes this the careful choice for what tells X from Y).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import least_squares

from lbacal_core.discovery.curve_causes import CurveCause, Power
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES, Instrument
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.lstcurve.noise import PointNoise
from lbacal_core.skypower.differences import model_difference_modes
from lbacal_core.skypower.table import SkyPower

GRID_HOURS: Floats = np.asarray(np.arange(32) * 0.75, dtype=np.float64)
"""Resolves |m| <= 15: the beam of a dipole leaves nothing above 8."""
FOLDS = 4
FOLD_HOURS = 2.0


@dataclass(frozen=True)
class CurveFit:
    """Sizes of causes fitted together, and what is left.

    Attributes
    ----------
    sizes, sigmas
        Shape (cause,).
    curve_db
        Fitted by dipole on `GRID_HOURS`, dB relative to LST 0 like the points.
    residual_db
        Measured minus model by dipole, shape (point,), NaN where there is no point.
    chi2, chi2_drawn
        With the estimated covariance, and with the drawn bars.
    """

    causes: tuple[CurveCause, ...]
    sizes: Floats
    sigmas: Floats
    curve_db: Mapping[str, Floats]
    residual_db: Mapping[str, Floats]
    chi2: float
    chi2_drawn: float
    points: int

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of its causes."""
        return tuple(cause.label for cause in self.causes)

    @property
    def dof(self) -> int:
        """Points less offsets and sizes."""
        return max(self.points - len(DIPOLES) - len(self.causes), 1)

    @property
    def scale(self) -> float:
        """Factor on the covariance where the points scatter more than it allows: chi^2 per degree of freedom, or 1.

        What such a simulation leaves is taken for its own error (the scale factor of the Particle Data Group).
        """
        return max(1.0, self.chi2 / self.dof)

    @property
    def is_at_edge(self) -> bool:
        """Whether a size has run to the end of its range."""
        return any(c.is_at_edge(size) for c, size in zip(self.causes, self.sizes.tolist(), strict=True))


class CurveFitter:
    """Fits of sets of causes to one curve."""

    def __init__(
        self, curve: LstCurve, sky_power: SkyPower, weights: Floats, noise: PointNoise, instrument: Instrument | None
    ) -> None:
        """With an instrument the sky is the package's own, and the spread of models counts as noise."""
        power = {d: np.maximum(sky_power.at(d, GRID_HOURS), 1e-6 * sky_power.power[d].max()) for d in DIPOLES}
        self.sky = SkyPower(sky_power.frequency_mhz, GRID_HOURS, power, sky_power.origin)
        self.curve, self.weights, self.noise = curve, weights, noise
        self.has_point = {d: curve.has_point(d) for d in DIPOLES}
        self.measured = np.concatenate([curve.variation_db[d][self.has_point[d]] for d in DIPOLES])
        drawn = np.broadcast_to(curve.error_db, curve.lst_hours.shape)
        self.drawn = np.concatenate([drawn[self.has_point[d]] for d in DIPOLES])
        self.lst = np.concatenate([curve.lst_hours[self.has_point[d]] for d in DIPOLES])
        counts = [int(self.has_point[d].sum()) for d in DIPOLES]
        self.offsets = np.repeat(np.eye(len(DIPOLES)), counts, axis=0)
        self._to_points = {d: _fourier(curve.lst_hours[self.has_point[d]]) for d in DIPOLES}
        self.covariance = noise.covariance(curve)
        self.model_variance = (0.0, 0.0)
        if instrument is not None:
            spread = self._model_spread(instrument)
            self.covariance = self.covariance + spread
            self.model_variance = (float(spread[0, 0]), float(spread[-1, -1]))

    def _model_spread(self, instrument: Instrument) -> Floats:
        """Covariance of the points, dB^2, by which sky and antenna models differ, shape (point, point)."""
        modes = model_difference_modes(self.sky.frequency_mhz, GRID_HOURS, instrument.dipole_azimuth_deg)
        plain = self.band(self.sky.power)
        blocks = []
        for d in DIPOLES:
            changed = [self.band({**self.sky.power, d: self.sky.power[d] * np.exp(mode)})[d] for mode in modes[d]]
            terms = np.fft.rfft(10 * np.log10(np.array(changed) / plain[d]), axis=1)[:, 1:-1] / GRID_HOURS.size
            hours = self.curve.lst_hours[self.has_point[d]]
            angle = 2 * np.pi / 24.0 * (hours[:, None] - hours[None, :])
            order = np.arange(1, terms.shape[1] + 1)
            blocks.append(np.cos(angle[..., None] * order) @ (2 * np.sum(np.abs(terms) ** 2, axis=0)))
        return np.asarray(block_diag(*blocks))

    def band(self, power: Power) -> dict[str, Floats]:
        """Band power of each dipole over its mean over LST, on the grid, shape (lst,)."""
        total = {d: power[d] @ self.weights for d in DIPOLES}
        return {d: total[d] / total[d].mean() for d in DIPOLES}

    def points_db(self, power: Power) -> Floats:
        """Band power of all points, X then Y, in dB about the mean over LST, offsets left out."""
        band = self.band(power)
        points = np.concatenate([self._to_points[d] @ band[d] for d in DIPOLES])
        return np.asarray(10 * np.log10(np.maximum(points, 1e-6)))

    def power_with(self, causes: Sequence[CurveCause], sizes: Floats) -> dict[str, Floats]:
        """P_sky with causes applied, in the order given."""
        power = dict(self.sky.power)
        for cause, size in zip(causes, sizes.tolist(), strict=True):
            power = {d: np.maximum(v, 1e-6 * v.max()) for d, v in cause.act(power, size).items()}
        return power

    def fit(
        self, causes: Sequence[CurveCause], rows: Floats | None = None, starts: Sequence[Sequence[float]] = ()
    ) -> CurveFit:
        """Sizes and offsets that make the points (of `rows`, if given) most probable.

        Parameters
        ----------
        starts
            Sizes to start from; where none are given, those of the causes.
        """
        kept = np.arange(self.measured.size) if rows is None else np.flatnonzero(rows)
        root = np.linalg.cholesky(self.covariance[np.ix_(kept, kept)])
        design = solve_triangular(root, self.offsets[kept], lower=True)
        absorbed = np.linalg.qr(design)[0]

        def residual(sizes: Floats) -> Floats:
            difference = self.measured[kept] - self.points_db(self.power_with(causes, sizes))[kept]
            white = solve_triangular(root, difference, lower=True)
            return np.asarray(white - absorbed @ (absorbed.T @ white))

        sizes, sigmas = np.zeros(len(causes)), np.zeros(len(causes))
        if causes:
            sizes, sigmas = _minimise(residual, causes, starts)
        power = self.power_with(causes, sizes)
        difference = self.measured - self.points_db(power)
        white = solve_triangular(root, difference[kept], lower=True)
        offsets = np.linalg.lstsq(design, white, rcond=None)[0]
        left = difference - self.offsets @ offsets
        white = white - design @ offsets
        band = self.band(power)
        return CurveFit(
            tuple(causes),
            sizes,
            sigmas,
            {d: 10 * np.log10(band[d]) + offsets[k] for k, d in enumerate(DIPOLES)},
            {d: self._spread(left, k, d) for k, d in enumerate(DIPOLES)},
            float(white @ white),
            self._chi2_drawn(difference),
            kept.size,
        )

    def _spread(self, values: Floats, k: int, dipole: str) -> Floats:
        spread = np.full(self.curve.lst_hours.shape, np.nan)
        spread[self.has_point[dipole]] = values[self.offsets[:, k] > 0]
        return spread

    def _chi2_drawn(self, difference: Floats) -> float:
        """With the drawn bars and offsets of their own."""
        design, white = self.offsets / self.drawn[:, None], difference / self.drawn
        return float(np.sum((white - design @ np.linalg.lstsq(design, white, rcond=None)[0]) ** 2))

    def chi2_of(self, left: Floats, rows: Floats) -> float:
        """Chi^2 of given residuals at given points."""
        kept = np.flatnonzero(rows)
        white = solve_triangular(np.linalg.cholesky(self.covariance[np.ix_(kept, kept)]), left[kept], lower=True)
        return float(white @ white)

    def held_out_gain(self, fewer: CurveFit, more: CurveFit) -> float:
        """Gain in log-likelihood on blocks of 2 h of LST that were not fitted, given the blocks that were."""
        fold = (self.lst // FOLD_HOURS).astype(int) % FOLDS
        everything = np.ones(self.lst.size, dtype=bool)
        gain = 0.0
        for k in range(FOLDS):
            is_train = fold != k
            surprise = []
            for one in (fewer, more):
                fitted = self.fit(one.causes, is_train, [one.sizes.tolist()] if one.causes else ())
                left = np.concatenate([fitted.residual_db[d][self.has_point[d]] for d in DIPOLES])
                surprise.append(self.chi2_of(left, everything) - self.chi2_of(left, is_train))
            gain += 0.5 * (surprise[0] - surprise[1])
        return gain

    def calibration_change(self, fewer: CurveFit, more: CurveFit) -> dict[str, Floats]:
        """C with more causes over C with fewer, minus 1, by dipole, shape (freq,).

        At each frequency the recorded power is a line in P_sky, whose slope is C^-2. Data that follow the larger model
        have, against the smaller one, the slope cov(new, old)/var(old) over LST; its root is what C changes by.
        """
        old, new = self.power_with(fewer.causes, fewer.sizes), self.power_with(more.causes, more.sizes)
        change = {}
        for d in DIPOLES:
            about = old[d] - old[d].mean(axis=0)
            slope = np.sum(about * (new[d] - new[d].mean(axis=0)), axis=0) / np.sum(about**2, axis=0)
            change[d] = np.sqrt(np.maximum(slope, 0.0)) - 1.0
        return change

    def signature(self, fewer: CurveFit, more: CurveFit) -> Floats:
        """What the larger model changes at the points, whitened and without what the offsets absorb."""
        root = np.linalg.cholesky(self.covariance)
        new, old = (self.points_db(self.power_with(one.causes, one.sizes)) for one in (more, fewer))
        white = solve_triangular(root, new - old, lower=True)
        absorbed = np.linalg.qr(solve_triangular(root, self.offsets, lower=True))[0]
        return np.asarray(white - absorbed @ (absorbed.T @ white))


def _minimise(
    residual: Callable[[Floats], Floats], causes: Sequence[CurveCause], starts: Sequence[Sequence[float]]
) -> tuple[Floats, Floats]:
    bounds = (np.array([c.lowest for c in causes]), np.array([c.highest for c in causes]))
    span = np.array([max(abs(c.starts[-1]), 0.1) for c in causes])
    tries = max(len(c.starts) for c in causes)
    starts = starts or [[c.starts[k % len(c.starts)] for c in causes] for k in range(tries)]
    inside = 1e-4 * (bounds[1] - bounds[0])
    found = min(
        (
            least_squares(
                residual,
                np.clip(np.array(start), bounds[0] + inside, bounds[1] - inside),
                bounds=bounds,
                x_scale=span,
                max_nfev=60,
            )
            for start in starts
        ),
        key=lambda one: float(one.cost),
    )
    information = found.jac.T @ found.jac + 1e-12 * np.diag(span**-2.0)
    return np.asarray(found.x), np.sqrt(np.diag(np.linalg.inv(information)))


def _fourier(lst_hours: Floats) -> Floats:
    """From values on `GRID_HOURS` to any LST, shape (point, grid)."""
    count = GRID_HOURS.size
    order = np.arange(1, count // 2)
    angle = 2 * np.pi / 24.0 * (np.asarray(lst_hours)[:, None] - GRID_HOURS[None, :])
    return np.asarray((1.0 + 2.0 * np.cos(angle[..., None] * order).sum(axis=-1)) / count)
