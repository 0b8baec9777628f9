"""Fits of sets of causes to one LST curve: sizes, noise and an offset a dipole, under the covariance of the points.

The covariance is the point noise, with what the dipoles share, and for the package's own sky the spread of sky and
antenna models. The known alternatives, two skies and one antenna, give the size of the next model's difference, and not
its dependence on LST. At each harmonic of the sidereal day the difference therefore has the variance of the known ones
and any phase. The dipoles differ independently; the known differences are alike in X and Y, so that this is the careful
choice for causes that act on X and Y differently.

The ratio of electronic noise to the mean sky power is fitted with its prior. A set that contains `missing_noise` has
the noise of the prior's mean, and that cause beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from lbacal_core.calibration.lines import fit_lines
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.causes.axes import axes_of
from lbacal_core.causes.catalogue import CAUSES, DESCRIPTIONS
from lbacal_core.causes.cause import Cause, Conditions, SizeRange, Template
from lbacal_core.causes.sky import sky_ratios
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms, Intercepts
from lbacal_core.linear import find_whitener, fit_least_squares, invert_symmetric
from lbacal_core.lstcurve.curve import LARGEST_RATIO, LstCurve, NoisePrior, PointNoise
from lbacal_core.simulation.simulation import Simulation

# What causes found in an LST curve do to C: the chain fitted to a station-year of data that contain them.
#
# At one channel recorded power is a line in P_sky, but the intercepts of all channels are tied by three noise levels. A
# wrong sky makes the channels disagree, and the change of C depends on how the fit weighs them: it is quoted for the
# mean of a station's 48 antennas in a year of 900 events. A single path, whose radiometer noise is larger, changes by
# more.

RADIOMETER, EVENT_GAIN = 0.044 / 48**0.5, read_prior()["event_gain"].size
"""Noise per MHz of the mean of a station's paths, and the event gain that they share (docs/explanation/the-fit.md)."""
DRAWS = 14
"""Pairs of events at each of 32 LSTs: 896 events. The two of a pair scatter oppositely, so that the slopes do not."""


def fit_station_year(power: Floats, sky: Floats, terms: Intercepts) -> Floats:
    """Slopes of the chain of each dipole, shape (dipole, freq), fitted to power with the scatter of a station-year.

    Parameters
    ----------
    power, sky
        Recorded power without scatter and P_sky of the simulation, shape (dipole, lst, freq).
    terms
        The noise constants of the chain.
    """
    rng = np.random.default_rng(0)
    half = DRAWS * power.shape[1]
    drawn = EVENT_GAIN * rng.standard_normal((half, 1)) + RADIOMETER * rng.standard_normal((half, power.shape[2]))
    scatter = 1.0 + np.concatenate([drawn, -drawn])
    lst = np.arange(2 * half) % power.shape[1]
    slopes = []
    for own, simulated in zip(power, sky, strict=True):
        lines = fit_lines((own[lst] * scatter)[None], simulated[lst], np.ones((1, lst.size)))
        slopes.append(solve_separable(lines.slope, lines.intercept, lines.information, terms).x[0])
    return np.stack(slopes)


# An LST curve as a station of the classes X and Y on the axis LST: conditions, chain, and causes that it can show.
#
# The band power is the sum over channels of (P_sky + noise) x weight. The baseline contains the electronic noise of all
# stages, whose ratio to the mean sky power has a prior (`lbacal_core.lstcurve.curve`).

GRID_HOURS: Floats = np.asarray(np.arange(32) * 0.75, dtype=np.float64)
"""Resolves |m| <= 15: the beam of a dipole leaves nothing above 8."""
SMALLEST_SKY = 1e-6
"""Share of the largest P_sky below which no cause makes it fall: the logarithm of the power exists."""
SMALLEST_BEND = 1e-4
"""Share of the squared change of the band power that varies with LST, below which the offset describes a cause:
doubled power then bends the curve by 0.03 dB, less than the noise of a point."""
ABSORBED = "the free level of the curve, or its free noise, describes the change"


@dataclass(frozen=True)
class Choice:
    """A cause with one template, as a fit of an LST curve takes it; its sizes are in units of `scale`."""

    cause: Cause
    template: Template
    scale: float = 1.0
    is_alias: bool = False

    @property
    def label(self) -> str:
        """Identifier, with the parameters of the template."""
        return self.cause.label(self.template)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of its effect on the band power; choices with a common kind are never fitted together."""
        return self.cause.kinds(self.template)

    @property
    def sizes(self) -> SizeRange:
        """Sizes that a fit may take."""
        return self.cause.sizes_of(self.template)

    @property
    def is_statement(self) -> bool:
        """Whether it is true or not, at its one size, for the whole array."""
        return self.cause.whole_array_size is not None


@dataclass(frozen=True)
class CurveStation:
    """P_sky of the classes X and Y on `GRID_HOURS`, with the band's weights, for causes to act on.

    The noise of `terms` is as large as the mean sky power of the band; `terms_with` scales it.
    """

    conditions: Conditions
    terms: ChainTerms
    prior: NoisePrior

    @property
    def weights(self) -> Floats:
        """Weight of every channel in the band power, shape (freq,)."""
        return np.asarray(self.terms.front[0, 0])

    @property
    def channels_mhz(self) -> Floats:
        """Channels of the band, shape (freq,)."""
        return self.conditions.frequency_mhz[self.weights > 0]

    def is_described(self, choice: Choice) -> bool:
        """Whether what the baseline leaves free describes a small size: the level, and noise of which nothing is known.

        A small size is added to a sky without noise.
        """
        whole = self.terms_with([], np.zeros(0), 0.0).power().sum(axis=-1)
        change = np.log(self.terms_with([choice], np.array([choice.cause.step]), 0.0).power().sum(axis=-1) / whole)
        bent = 0.0
        for own, power in zip(change, whole, strict=True):
            free = np.stack([np.ones_like(power), power.mean() / power], axis=1)[:, : 1 if self.prior.is_known else 2]
            bent += float(np.sum((own - free @ fit_least_squares(free, own)) ** 2))
        return bool(bent <= SMALLEST_BEND * np.sum(change**2))

    def terms_with(self, choices: Sequence[Choice], sizes: Floats, noise: float) -> ChainTerms:
        """The chain with noise over mean sky power, and causes at sizes, shape (choice,), one after the other."""
        own = self.terms
        terms = replace(
            own, n_lna=noise * own.n_lna, receiver_noise=noise * own.receiver_noise, adc_noise=noise * own.adc_noise
        )
        for choice, size in zip(choices, sizes.tolist(), strict=True):
            terms = choice.cause.apply(terms, self.conditions, choice.template, size * choice.scale)
            least = SMALLEST_SKY * terms.sky.max(axis=(1, 2), keepdims=True)
            terms = replace(terms, sky=np.maximum(terms.sky, least))
        return terms


def gather_curve(simulation: Simulation, weights: Floats, prior: NoisePrior) -> CurveStation:
    """Lay out the simulation of an LST curve.

    Parameters
    ----------
    weights
        Weight of every channel in the band power, shape (freq,).
    """
    sky = np.stack([simulation.sky_power.at(d, GRID_HOURS) for d in DIPOLES])
    sky = np.maximum(sky, SMALLEST_SKY * sky.max(axis=(1, 2), keepdims=True))
    unknown = np.full(GRID_HOURS.size, np.nan)
    conditions = Conditions(
        frequency_mhz=simulation.instrument.frequency_mhz,
        time_unix=unknown,
        lst_hours=GRID_HOURS,
        utc_hours=unknown,
        sun_altitude=unknown,
        sun_azimuth=unknown,
        dipoles=DIPOLES,
        cables=["all"] * len(DIPOLES),
        mean_sky=sky.mean(axis=1),
        sky_of={d: simulation.sky_power.at(d, GRID_HOURS) for d in DIPOLES},
        sky_at=lambda hours: np.stack([simulation.sky_power.at(d, hours) for d in DIPOLES]),
        antenna_gain=simulation.instrument.antenna_gain,
        receiver_gain=simulation.instrument.receiver_gain,
        noise=simulation.noise,
        cable_log_loss=np.zeros((len(DIPOLES), simulation.instrument.frequency_mhz.size)),
        sky_ratio={name: ratio.at(DIPOLES, GRID_HOURS) for name, ratio in sky_ratios(simulation.instrument).items()},
        known_noise=prior.mean if prior.is_known else None,
    )
    level = float((sky @ weights).mean() / prior.stages.sum())
    lna, receiver, adc = (level * stage for stage in prior.stages)
    at_antenna = np.divide(lna, weights, out=np.zeros_like(lna), where=weights > 0)
    return CurveStation(conditions, ChainTerms(sky, at_antenna, weights[None, None], receiver, adc), prior)


def list_choices(station: CurveStation) -> list[Choice]:
    """The causes that act along an axis of the curve and bend it, in the order in which they act."""
    conditions, known = station.conditions, axes_of(station.conditions)
    choices = [
        Choice(cause, template, cause.scale(station.terms), is_alias)
        for cause in CAUSES
        if known & set(cause.axes)
        for is_alias, templates in ((False, cause.templates(conditions)), (True, cause.far_templates(conditions)))
        for template in templates
    ]
    return [choice for choice in choices if not station.is_described(choice)]


def why_not(station: CurveStation, choices: Sequence[Choice]) -> Mapping[str, str]:
    """Causes of the catalogue that are not among the choices, with the reason."""
    known, chosen = axes_of(station.conditions), {choice.cause.identifier for choice in choices}
    reasons = {}
    for one in DESCRIPTIONS:
        if one.identifier in chosen:
            continue
        if not known & set(one.axes):
            reasons[one.identifier] = f"it acts along {' and '.join(one.axes)}, and the curve is a mean over them"
        elif isinstance(one, Cause) and not one.templates(station.conditions):
            reasons[one.identifier] = one.needs
        else:
            reasons[one.identifier] = ABSORBED
    return reasons


FOLDS = 4
FOLD_HOURS = 2.0
NO_START: Mapping[str, float] = {}
INSIDE = 1e-3
"""Distance of a start from the end of its range, in units of what the fit takes for a step."""


@dataclass(frozen=True)
class CurveFit:
    """Sizes of causes fitted together with the noise, and the residuals.

    Attributes
    ----------
    sizes, sigmas
        Shape (cause,); the standard deviation of a statement's size is 0.
    noise, noise_sigma
        Electronic noise over the mean sky power.
    curve_db
        Fitted by dipole on `GRID_HOURS`, dB relative to LST 0 like the points.
    residual_db
        Measured minus model by dipole, shape (point,), NaN where there is no point.
    chi2, chi2_drawn
        With the estimated covariance and the prior of the noise, and with the drawn bars alone.
    dof
        Points less offsets, free sizes, and a noise without a prior.
    """

    choices: tuple[Choice, ...]
    sizes: Floats
    sigmas: Floats
    noise: float
    noise_sigma: float
    curve_db: Mapping[str, Floats]
    residual_db: Mapping[str, Floats]
    chi2: float
    chi2_drawn: float
    points: int
    dof: int

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of its choices."""
        return tuple(choice.label for choice in self.choices)

    @property
    def per_point(self) -> dict[str, float]:
        """Chi^2 per point with the noise `estimated`, and with the `drawn_bars`."""
        return {"estimated": self.chi2 / self.points, "drawn_bars": self.chi2_drawn / self.points}

    @property
    def scale(self) -> float:
        """Factor on the covariance where the points scatter more than it allows: chi^2 per degree of freedom, or 1.

        Residuals beyond the noise count as an error of the simulation (the scale factor of the Particle Data Group).
        """
        return max(1.0, self.chi2 / self.dof)

    @property
    def is_at_edge(self) -> bool:
        """Whether a size has run to the end of its range."""
        return any(
            choice.sizes.is_at_edge(size)
            for choice, size in zip(self.choices, self.sizes.tolist(), strict=True)
            if not choice.is_statement
        )


class CurveFitter:
    """Fits of sets of causes to one curve."""

    def __init__(
        self, curve: LstCurve, station: CurveStation, noise: PointNoise, modes: Mapping[str, Floats] | None = None
    ) -> None:
        """Prepare the covariance; with `modes` the spread of sky and antenna models on `GRID_HOURS` is part of it."""
        self.curve, self.station, self.noise = curve, station, noise
        self.has_point = {d: curve.has_point(d) for d in DIPOLES}
        self.measured = self._join(curve.variation_db)
        drawn = np.broadcast_to(curve.error_db, curve.lst_hours.shape)
        self.drawn, self.lst = (
            self._join(dict.fromkeys(DIPOLES, drawn)),
            self._join(dict.fromkeys(DIPOLES, curve.lst_hours)),
        )
        counts = [int(self.has_point[d].sum()) for d in DIPOLES]
        self.offsets = np.repeat(np.eye(len(DIPOLES)), counts, axis=0)
        self._to_points = block_diag(*(_fourier(curve.lst_hours[self.has_point[d]]) for d in DIPOLES))
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

    def _join(self, by_dipole: Mapping[str, Floats]) -> Floats:
        """Values of the points, X then Y."""
        return np.concatenate([by_dipole[d][self.has_point[d]] for d in DIPOLES])

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

    def band_with(self, choices: Sequence[Choice], sizes: Floats, noise: float) -> Floats:
        """Band power of each dipole over its mean over LST, on the grid, shape (dipole, lst)."""
        total = self.station.terms_with(choices, sizes, noise).power().sum(axis=-1)
        return np.asarray(total / total.mean(axis=1, keepdims=True))

    def points_with(self, choices: Sequence[Choice], sizes: Floats, noise: float) -> Floats:
        """Band power of all points, X then Y, shape (point,), in dB about the mean over LST, offsets left out."""
        points = self._to_points @ self.band_with(choices, sizes, noise).ravel()
        return np.asarray(10 * np.log10(np.maximum(points, 1e-6)))

    def fit(
        self, choices: Sequence[Choice], rows: Floats | None = None, start: Mapping[str, float] = NO_START
    ) -> CurveFit:
        """Sizes, noise and offsets that make the points (of `rows`, if given) most probable.

        Parameters
        ----------
        start
            Sizes to start from, by label.
        """
        prior, dipoles = self.station.prior, len(DIPOLES)
        kept = np.arange(self.measured.size) if rows is None else np.flatnonzero(rows)
        whitener = find_whitener(self.covariance[np.ix_(kept, kept)])
        free = [choice for choice in choices if not choice.is_statement]
        is_free = np.array([not choice.is_statement for choice in choices], dtype=bool)
        has_own_noise = any(choice.cause.identifier == "missing_noise" for choice in choices)

        def sizes_of(values: Floats) -> Floats:
            sizes = np.array([choice.cause.whole_array_size or 0.0 for choice in choices])
            sizes[is_free] = values[dipoles + 1 :]
            return sizes

        def noise_of(values: Floats) -> float:
            return float(prior.mean if has_own_noise else values[dipoles])

        def left(values: Floats) -> Floats:
            model = self.points_with(choices, sizes_of(values), noise_of(values))
            return np.asarray(self.measured - model - self.offsets @ values[:dipoles])

        def residual(values: Floats) -> Floats:
            return np.append(whitener @ left(values)[kept], (values[dipoles] - prior.mean) / prior.sigma)

        lowest = [*[-np.inf] * dipoles, 0.0, *(choice.sizes.lowest for choice in free)]
        highest = [*[np.inf] * dipoles, LARGEST_RATIO, *(choice.sizes.highest for choice in free)]
        span = np.array([*[0.1] * (dipoles + 1), *(max(abs(choice.sizes.starts[-1]), 0.1) for choice in free)])
        tries = max((len(choice.sizes.starts) for choice in free if choice.label not in start), default=1)
        tried = []
        for k in range(tries):
            sizes = [start.get(one.label, one.sizes.starts[k % len(one.sizes.starts)]) for one in free]
            first = np.clip([*[0.0] * dipoles, prior.mean, *sizes], lowest + INSIDE * span, highest - INSIDE * span)
            tried.append(least_squares(residual, first, bounds=(lowest, highest), x_scale=span, max_nfev=60))
        found = min(tried, key=lambda one: float(one.cost))
        errors = np.sqrt(np.diag(invert_symmetric(found.jac.T @ found.jac + 1e-12 * np.diag(span**-2.0))))
        sigmas = np.zeros(len(choices))
        sigmas[is_free] = errors[dipoles + 1 :]
        best, noise = sizes_of(found.x), noise_of(found.x)
        band = 10 * np.log10(self.band_with(choices, best, noise)) + found.x[:dipoles, None]
        return CurveFit(
            choices=tuple(choices),
            sizes=best,
            sigmas=sigmas,
            noise=noise,
            noise_sigma=0.0 if has_own_noise else float(errors[dipoles]),
            curve_db=dict(zip(DIPOLES, band, strict=True)),
            residual_db=self._by_dipole(left(found.x)),
            chi2=2 * float(found.cost),
            chi2_drawn=self._chi2_drawn(left(found.x)),
            points=kept.size,
            dof=max(kept.size - dipoles - len(free) - (not prior.is_known), 1),
        )

    def _by_dipole(self, values: Floats) -> dict[str, Floats]:
        by_dipole = {}
        for k, d in enumerate(DIPOLES):
            by_dipole[d] = np.full(self.curve.lst_hours.shape, np.nan)
            by_dipole[d][self.has_point[d]] = values[self.offsets[:, k] > 0]
        return by_dipole

    def _chi2_drawn(self, difference: Floats) -> float:
        """With the drawn bars and offsets of their own."""
        design, white = self.offsets / self.drawn[:, None], difference / self.drawn
        return float(np.sum((white - design @ fit_least_squares(design, white)) ** 2))

    def _chi2_of(self, left: Floats, rows: Floats) -> float:
        """Chi^2 of given residuals at given points."""
        kept = np.flatnonzero(rows)
        white = find_whitener(self.covariance[np.ix_(kept, kept)]) @ left[kept]
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
                start = dict(zip(one.labels, one.sizes.tolist(), strict=True))
                left = self._join(self.fit(one.choices, is_train, start).residual_db)
                surprise.append(self._chi2_of(left, everything) - self._chi2_of(left, is_train))
            gain += 0.5 * (surprise[0] - surprise[1])
        return gain

    def calibration_change(self, fewer: CurveFit, more: CurveFit) -> dict[str, Floats]:
        """C with more causes over C with fewer, minus 1, by dipole at the channels of the band, shape (freq,).

        Data that follow the larger model are divided by what the smaller one does to the power, and fitted with the
        chain. C is proportional to slope^(-1/2).
        """
        station, inside = self.station, self.station.weights > 0
        new = station.terms_with(more.choices, more.sizes, more.noise).power()
        old = station.terms_with(fewer.choices, fewer.sizes, fewer.noise).power()
        plain = station.terms_with([], np.zeros(0), fewer.noise)
        terms, sky = station.conditions.intercepts.select(inside), plain.sky[..., inside]
        power = new[..., inside] * (plain.power() / old)[..., inside]
        named = fit_station_year(power, sky, terms)
        right = fit_station_year(plain.power()[..., inside], sky, terms)
        return dict(zip(DIPOLES, np.sqrt(np.maximum(named / right, 0.0)) - 1.0, strict=True))

    def signature(self, fewer: CurveFit, more: CurveFit) -> Floats:
        """Change of the points by the larger model, shape (point,), whitened, the offsets profiled out."""
        whitener = find_whitener(self.covariance)
        new, old = (self.points_with(one.choices, one.sizes, one.noise) for one in (more, fewer))
        white = whitener @ (new - old)
        absorbed = np.linalg.qr(whitener @ self.offsets)[0]
        return np.asarray(white - absorbed @ (absorbed.T @ white))


def _fourier(lst_hours: Floats) -> Floats:
    """From values on `GRID_HOURS` to any LST, shape (point, grid)."""
    count = GRID_HOURS.size
    order = np.arange(1, count // 2)
    angle = 2 * np.pi / 24.0 * (np.asarray(lst_hours)[:, None] - GRID_HOURS[None, :])
    return np.asarray((1.0 + 2.0 * np.cos(angle[..., None] * order).sum(axis=-1)) / count)
