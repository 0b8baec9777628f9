"""Fits of sets of causes to one LST curve: sizes and an offset a dipole, under the covariance of the points.

The covariance is the point noise, with what the dipoles share, and for the package's own sky the spread of sky and
antenna models. The known alternatives, two skies and one antenna, give the size of the next model's difference, and not
its dependence on LST. At each harmonic of the sidereal day the difference therefore has the variance of the known ones
and any phase. The dipoles differ independently; the known differences are alike in X and Y, so that this is the careful
choice for causes that act on X and Y differently.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import least_squares

from lbacal_core.causes.cause import SizeRange
from lbacal_core.discovery.curve_station import GRID_HOURS, Choice, CurveStation
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.lstcurve.noise import PointNoise

FOLDS = 4
FOLD_HOURS = 2.0


@dataclass(frozen=True)
class CurveFit:
    """Sizes of causes fitted together, and the residuals.

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

    choices: tuple[Choice, ...]
    sizes: Floats
    sigmas: Floats
    curve_db: Mapping[str, Floats]
    residual_db: Mapping[str, Floats]
    chi2: float
    chi2_drawn: float
    points: int

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of its choices."""
        return tuple(choice.label for choice in self.choices)

    @property
    def per_point(self) -> dict[str, float]:
        """Chi^2 per point with the estimated noise, and with the drawn bars."""
        return {"estimated": self.chi2 / self.points, "drawn_bars": self.chi2_drawn / self.points}

    @property
    def dof(self) -> int:
        """Points less offsets and sizes."""
        return max(self.points - len(DIPOLES) - len(self.choices), 1)

    @property
    def scale(self) -> float:
        """Factor on the covariance where the points scatter more than it allows: chi^2 per degree of freedom, or 1.

        Residuals beyond the noise count as an error of the simulation (the scale factor of the Particle Data Group).
        """
        return max(1.0, self.chi2 / self.dof)

    @property
    def is_at_edge(self) -> bool:
        """Whether a size has run to the end of its range."""
        return any(c.sizes.is_at_edge(size) for c, size in zip(self.choices, self.sizes.tolist(), strict=True))


class CurveFitter:
    """Fits of sets of causes to one curve."""

    def __init__(
        self, curve: LstCurve, station: CurveStation, noise: PointNoise, modes: Mapping[str, Floats] | None = None
    ) -> None:
        """Prepare the covariance; with `modes` the spread of sky and antenna models on `GRID_HOURS` is part of it."""
        self.curve, self.station, self.noise = curve, station, noise
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
        if modes is not None:
            spread = self._model_spread(modes)
            self.covariance = self.covariance + spread
            self.model_variance = (float(spread[0, 0]), float(spread[-1, -1]))

    @property
    def has_model_spread(self) -> bool:
        """Whether the spread of sky and antenna models counts as noise."""
        return self.model_variance != (0.0, 0.0)

    def _model_spread(self, modes: Mapping[str, Floats]) -> Floats:
        """Covariance of the points, dB^2, by which sky and antenna models differ, shape (point, point)."""
        sky, weights = self.station.terms.sky, self.station.weights
        blocks = []
        for d, own in zip(DIPOLES, sky, strict=True):
            changed = 10 * np.log10((own * np.exp(modes[d])) @ weights / (own @ weights))
            terms = np.fft.rfft(changed, axis=1)[:, 1:-1] / GRID_HOURS.size
            hours = self.curve.lst_hours[self.has_point[d]]
            angle = 2 * np.pi / 24.0 * (hours[:, None] - hours[None, :])
            order = np.arange(1, terms.shape[1] + 1)
            blocks.append(np.cos(angle[..., None] * order) @ (2 * np.sum(np.abs(terms) ** 2, axis=0)))
        return np.asarray(block_diag(*blocks))

    def band_with(self, choices: Sequence[Choice], sizes: Floats) -> dict[str, Floats]:
        """Band power of each dipole over its mean over LST, on the grid, with causes at sizes, shape (lst,)."""
        total = self.station.terms_with(choices, sizes).power().sum(axis=-1)
        return dict(zip(DIPOLES, total / total.mean(axis=1, keepdims=True), strict=True))

    def points_with(self, choices: Sequence[Choice], sizes: Floats) -> Floats:
        """Band power of all points, X then Y, in dB about the mean over LST, offsets left out."""
        band = self.band_with(choices, sizes)
        points = np.concatenate([self._to_points[d] @ band[d] for d in DIPOLES])
        return np.asarray(10 * np.log10(np.maximum(points, 1e-6)))

    def fit(
        self, choices: Sequence[Choice], rows: Floats | None = None, starts: Sequence[Sequence[float]] = ()
    ) -> CurveFit:
        """Sizes and offsets that make the points (of `rows`, if given) most probable.

        Parameters
        ----------
        starts
            Sizes to start from; where none are given, those of the choices.
        """
        kept = np.arange(self.measured.size) if rows is None else np.flatnonzero(rows)
        root = np.linalg.cholesky(self.covariance[np.ix_(kept, kept)])
        design = solve_triangular(root, self.offsets[kept], lower=True)
        absorbed = np.linalg.qr(design)[0]

        def residual(sizes: Floats) -> Floats:
            difference = self.measured[kept] - self.points_with(choices, sizes)[kept]
            white = solve_triangular(root, difference, lower=True)
            return np.asarray(white - absorbed @ (absorbed.T @ white))

        sizes, sigmas = np.zeros(len(choices)), np.zeros(len(choices))
        if choices:
            sizes, sigmas = _minimise(residual, [choice.sizes for choice in choices], starts)
        difference = self.measured - self.points_with(choices, sizes)
        white = solve_triangular(root, difference[kept], lower=True)
        offsets = np.linalg.lstsq(design, white, rcond=None)[0]
        left = difference - self.offsets @ offsets
        white = white - design @ offsets
        band = self.band_with(choices, sizes)
        return CurveFit(
            tuple(choices),
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
                fitted = self.fit(one.choices, is_train, [one.sizes.tolist()] if one.choices else ())
                left = np.concatenate([fitted.residual_db[d][self.has_point[d]] for d in DIPOLES])
                surprise.append(self.chi2_of(left, everything) - self.chi2_of(left, is_train))
            gain += 0.5 * (surprise[0] - surprise[1])
        return gain

    def calibration_change(self, fewer: CurveFit, more: CurveFit) -> dict[str, Floats]:
        """C with more causes over C with fewer, minus 1, by dipole at the channels of the band, shape (freq,).

        At each frequency the recorded power is a line in P_sky, whose slope is C^-2. Data that follow the larger model
        have, against the smaller one, the slope cov(new, old)/var(old) over LST; C changes by its root.
        """
        inside = self.station.weights > 0
        old, new = (self.station.terms_with(one.choices, one.sizes).power()[..., inside] for one in (fewer, more))
        about = old - old.mean(axis=1, keepdims=True)
        slope = np.sum(about * (new - new.mean(axis=1, keepdims=True)), axis=1) / np.sum(about**2, axis=1)
        return dict(zip(DIPOLES, np.sqrt(np.maximum(slope, 0.0)) - 1.0, strict=True))

    def signature(self, fewer: CurveFit, more: CurveFit) -> Floats:
        """Change of the points by the larger model, whitened, the offsets profiled out."""
        root = np.linalg.cholesky(self.covariance)
        new, old = (self.points_with(one.choices, one.sizes) for one in (more, fewer))
        white = solve_triangular(root, new - old, lower=True)
        absorbed = np.linalg.qr(solve_triangular(root, self.offsets, lower=True))[0]
        return np.asarray(white - absorbed @ (absorbed.T @ white))


def _minimise(
    residual: Callable[[Floats], Floats], ranges: Sequence[SizeRange], starts: Sequence[Sequence[float]]
) -> tuple[Floats, Floats]:
    bounds = (np.array([c.lowest for c in ranges]), np.array([c.highest for c in ranges]))
    span = np.array([max(abs(c.starts[-1]), 0.1) for c in ranges])
    tries = max(len(c.starts) for c in ranges)
    starts = starts or [[c.starts[k % len(c.starts)] for c in ranges] for k in range(tries)]
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
