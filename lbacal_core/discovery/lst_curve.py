"""The same question asked of band-averaged LST curves: fewer axes, fewer causes, but published of the real instrument.

The model is the band power of P_sky relative to its level at LST 0, an offset a dipole free. Causes are added one by
one, each time the one that makes the points most probable, all sizes fitted together. The point noise is estimated from
the scatter about a smooth curve; with the package's own sky the spread of sky and antenna models is part of the
covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi_squared

from lbacal_core.discovery.baseline import SOURCE_KEYS, relative_sky_changes
from lbacal_core.discovery.scan import p_of, significance
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument import DIPOLES, Instrument
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights, estimate_point_noise
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.differences import model_difference_modes
from lbacal_core.skypower.table import SkyPower

ALPHA_CATALOGUE, ALPHA_LEFTOVER = 0.0025, 0.002
MAX_FINDINGS = 4
FOLDS = 4
INDISTINGUISHABLE = 9.0
OTHER = {"X": "Y", "Y": "X"}
NEEDS_MORE_AXES = (
    "solar_emission", "ionospheric_absorption", "resonance_shift", "resonance_width", "filter_shift", "lna_noise_slope",
    "lna_noise_temperature", "gain_temperature", "cable_length", "cable_reflection", "cable_temperature", "gain_step",
    "gain_drift", "adc_noise_step", "compression", "adc_jitter", "rfi_line", "rfi_broadband",
)  # fmt: skip
"""Causes that act along frequency, time of day, date or temperature."""


@dataclass(frozen=True)
class CurveCause:
    """A cause that acts on P_sky of a dipole, with the range of its size.

    Attributes
    ----------
    act
        (P_sky by dipole on the grid, sky power, size) -> changed P_sky by dipole.
    """

    identifier: str
    unit: str
    meaning: str
    confirm: str
    lowest: float
    highest: float
    act: Callable[[Mapping[str, Floats], SkyPower, float], dict[str, Floats]]
    parameters: Mapping[str, str]

    @property
    def label(self) -> str:
        """Identifier, with the source where it names one."""
        return " ".join([self.identifier, *self.parameters.values()])


@dataclass(frozen=True)
class CurveFit:
    """Sizes of causes fitted together, and what is left.

    Attributes
    ----------
    sizes, sigmas
        Shape (cause,).
    offsets_db
        By dipole.
    residual_db
        Measured minus model by dipole, shape (point,), NaN where there is no point.
    chi2, chi2_drawn
        With the estimated covariance, and with the drawn bars.
    """

    causes: list[CurveCause]
    sizes: Floats
    sigmas: Floats
    residual_db: Mapping[str, Floats]
    chi2: float
    chi2_drawn: float
    points: int


@dataclass(frozen=True)
class CurveStep:
    """One finding: the fit before and after, its rivals with their chi^2, and the gain on points not used."""

    cause: CurveCause
    before: CurveFit
    after: CurveFit
    rivals: list[tuple[CurveCause, float]]
    p_value: float
    z: float
    trials: float
    held_out_gain: float
    calibration_change: Floats


@dataclass(frozen=True)
class CurveInvestigation:
    """What an LST curve says of a simulation."""

    steps: list[CurveStep]
    first: CurveFit
    last: CurveFit
    leftover_p: float
    point_noise_db: Mapping[str, float]
    tried: list[tuple[CurveCause, float]]


def curve_causes(instrument: Instrument, sky_power: SkyPower) -> list[CurveCause]:
    """The causes that a band-averaged LST curve can show."""

    def scaled(change: SkyPower) -> Callable[[Mapping[str, Floats], SkyPower, float], dict[str, Floats]]:
        relative = {d: np.log(change.at(d, sky_power.lst_hours)) for d in DIPOLES}
        return lambda power, _, size: {d: power[d] * np.exp(size * relative[d]) for d in DIPOLES}

    def swapped(power: Mapping[str, Floats], _: SkyPower, size: float) -> dict[str, Floats]:
        return {d: (1 - size) * power[d] + size * power[OTHER[d]] for d in DIPOLES}

    def moved(power: Mapping[str, Floats], sky: SkyPower, size: float) -> dict[str, Floats]:
        table = SkyPower(sky.frequency_mhz, sky.lst_hours, power, "moved")
        return {d: table.at(d, sky.lst_hours + size) for d in DIPOLES}

    def raised(power: Mapping[str, Floats], sky: SkyPower, size: float) -> dict[str, Floats]:
        return {d: power[d] + size * sky.power[d].mean(axis=0) for d in DIPOLES}

    none: dict[str, str] = {}
    causes = [
        CurveCause("dipole_swap", "share, 1 = exchanged", "the dipoles X and Y are mixed or exchanged",
                   "unplug one dipole, or compare the azimuths of the arms with the file that names them",
                   0.0, 1.0, swapped, none),
        CurveCause("lst_offset", "h", "the sidereal time of data or simulation is off",
                   "ask whether lst_h is the edge or the centre of the bin", -3.0, 3.0, moved, none),
        CurveCause("missing_noise", "fraction of the mean sky power at each frequency", "a noise stage is missing",
                   "measure the noise with a dummy load", 0.0, 10.0, raised, none),
        CurveCause("isotropic_level", "fraction of the mean sky power", "the isotropic part of the sky is wrong",
                   "compare with an absolute measurement of the sky minimum", -0.5, 10.0, raised, none),
    ]  # fmt: skip
    changes = relative_sky_changes(instrument)
    for key, unit, meaning, confirm, span in (
        ("dipole_azimuth", "deg", "the arms of the dipoles stand at another azimuth", "survey the antennas", 50.0),
        ("zenith_weighting", "exponent", "the sky integral weighs with a wrong power of cos(zenith)",
         "repeat the integral for a uniform sky", 1.5),
        ("pattern_width", "fraction", "the antenna pattern is too wide or too narrow",
         "measure the pattern with a source on a drone", 0.6),
    ):  # fmt: skip
        if key in changes:
            causes.append(CurveCause(key, unit, meaning, confirm, -span, span, scaled(changes[key]), none))
    for name in SOURCE_KEYS:
        if name in changes:
            act = scaled(changes[name])
            confirm = "follow the excess through the source's transit at several frequencies"
            causes.append(CurveCause("point_source", "fraction of its flux", f"{name} is wrong in the sky model",
                                     confirm, -1.5, 5.0, act, {"source": name}))  # fmt: skip
    return causes


def investigate_curve(
    curve: LstCurve, sky_power: SkyPower, instrument: Instrument, band_mhz: tuple[float, float], *, is_own_sky: bool
) -> CurveInvestigation:
    """Ask an LST curve what a simulated sky power gets wrong."""
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, instrument.name)
    weights = band_weights(instrument, AS_RECORDED, band_mhz)
    noise = {d: estimate_point_noise(curve, d) for d in DIPOLES}
    if any(value is None for value in noise.values()):
        raise BadInputError(curve.origin, "20 points or more a dipole", "too few to estimate their noise")
    fitter = _Fitter(curve, sky_power, weights, {d: float(v or 0.0) for d, v in noise.items()}, is_own_sky, instrument)
    causes = curve_causes(instrument, sky_power)
    first = current = fitter.fit([])
    steps: list[CurveStep] = []
    tried: list[tuple[CurveCause, float]] = []
    while len(steps) < MAX_FINDINGS:
        left = [c for c in causes if c.label not in {one.label for one in current.causes}]
        fits = sorted(((c, fitter.fit([*current.causes, c])) for c in left), key=lambda item: item[1].chi2)
        tried = tried or [(c, first.chi2 - fit.chi2) for c, fit in fits]
        cause, after = fits[0]
        z = float(np.sqrt(max(current.chi2 - after.chi2, 0.0)))
        p_value = p_of(z, float(len(causes)))
        if p_value >= ALPHA_CATALOGUE:
            break
        gain = fitter.held_out_gain(current.causes, cause)
        if gain <= 0:
            break
        rivals = [(c, fit.chi2) for c, fit in fits[1:] if fit.chi2 - after.chi2 < INDISTINGUISHABLE]
        change = fitter.calibration_change(current, after)
        steps.append(CurveStep(cause, current, after, rivals, p_value, z, float(len(causes)), gain, change))
        current = after
    dof = max(current.points - len(DIPOLES) - len(current.causes), 1)
    leftover = float(chi_squared.sf(current.chi2, dof))
    return CurveInvestigation(steps, first, current, leftover, fitter.noise_db, tried)


class _Fitter:
    """Fits of sets of causes to one curve."""

    def __init__(
        self,
        curve: LstCurve,
        sky_power: SkyPower,
        weights: Floats,
        noise_db: Mapping[str, float],
        is_own_sky: bool,
        instrument: Instrument,
    ) -> None:
        self.curve, self.sky, self.weights, self.noise_db = curve, sky_power, weights, noise_db
        self.has_point = {d: curve.has_point(d) for d in DIPOLES}
        self.measured = np.concatenate([curve.variation_db[d][self.has_point[d]] for d in DIPOLES])
        drawn = np.broadcast_to(curve.error_db, curve.lst_hours.shape)
        self.drawn = np.concatenate([drawn[self.has_point[d]] for d in DIPOLES])
        counts = [int(self.has_point[d].sum()) for d in DIPOLES]
        self.offsets = np.repeat(np.eye(len(DIPOLES)), counts, axis=0)
        covariance = np.diag(np.repeat([noise_db[d] ** 2 for d in DIPOLES], counts))
        if is_own_sky:
            spread = self._mode_columns(instrument)
            covariance = covariance + spread.T @ spread
        self.root = np.linalg.cholesky(covariance)

    def _mode_columns(self, instrument: Instrument) -> Floats:
        modes = model_difference_modes(self.sky.frequency_mhz, self.sky.lst_hours, instrument.dipole_azimuth_deg)
        plain = self.model_db([], np.zeros(0))
        columns = []
        for d in DIPOLES:
            for mode in modes[d]:
                power = {**self.sky.power, d: self.sky.power[d] * np.exp(mode)}
                columns.append(self._band_db(power) - plain)
        return np.array(columns)

    def _band_db(self, power: Mapping[str, Floats]) -> Floats:
        table = SkyPower(self.sky.frequency_mhz, self.sky.lst_hours, power, "with causes")
        parts = []
        for d in DIPOLES:
            band = table.at(d, self.curve.lst_hours[self.has_point[d]]) @ self.weights
            parts.append(10 * np.log10(np.maximum(band / float((power[d] @ self.weights).mean()), 1e-6)))
        return np.concatenate(parts)

    def power_with(self, causes: Sequence[CurveCause], sizes: Floats) -> dict[str, Floats]:
        """P_sky with causes applied, in the order given."""
        power = dict(self.sky.power)
        for cause, size in zip(causes, sizes.tolist(), strict=True):
            changed = cause.act(power, self.sky, size)
            power = {d: np.maximum(values, 1e-6 * values.max()) for d, values in changed.items()}
        return power

    def model_db(self, causes: Sequence[CurveCause], sizes: Floats) -> Floats:
        """Band power of all points in dB about its mean over LST, offsets left out."""
        return self._band_db(self.power_with(causes, sizes))

    def fit(self, causes: Sequence[CurveCause], rows: Floats | None = None) -> CurveFit:
        """Sizes and offsets that make the points (of `rows`, if given) most probable."""
        kept = np.arange(self.measured.size) if rows is None else np.flatnonzero(rows)
        root = np.linalg.cholesky((self.root @ self.root.T)[np.ix_(kept, kept)])
        design = solve_triangular(root, self.offsets[kept], lower=True)

        def residual(sizes: Floats) -> Floats:
            difference = self.measured[kept] - self.model_db(causes, sizes)[kept]
            white = solve_triangular(root, difference, lower=True)
            return np.asarray(white - design @ np.linalg.lstsq(design, white, rcond=None)[0])

        sizes, sigmas = np.zeros(len(causes)), np.zeros(len(causes))
        if causes:
            bounds = (np.array([c.lowest for c in causes]), np.array([c.highest for c in causes]))
            span = np.minimum(bounds[1] - bounds[0], 2.0)
            starts = [np.clip(fraction * span, *bounds) for fraction in (0.02, 0.35, -0.2)]
            found = min(
                (least_squares(residual, s, bounds=bounds, x_scale=span, method="trf", max_nfev=60) for s in starts),
                key=lambda one: one.cost,
            )
            sizes = np.asarray(found.x)
            information = found.jac.T @ found.jac + 1e-12 * np.eye(len(causes))
            sigmas = np.sqrt(np.diag(np.linalg.inv(information)))
        white = residual(sizes)
        difference = self.measured - self.model_db(causes, sizes)
        full = np.linalg.lstsq(design, solve_triangular(root, difference[kept], lower=True), rcond=None)[0]
        difference = difference - self.offsets @ full
        drawn = (
            difference
            - self.offsets @ np.linalg.lstsq(self.offsets / self.drawn[:, None], difference / self.drawn, rcond=None)[0]
        )
        left = {}
        start = 0
        for d in DIPOLES:
            values = np.full(self.curve.lst_hours.shape, np.nan)
            stop = start + int(self.has_point[d].sum())
            values[self.has_point[d]] = difference[start:stop]
            left[d], start = values, stop
        return CurveFit(
            list(causes), sizes, sigmas, left, float(white @ white), float(np.sum((drawn / self.drawn) ** 2)), kept.size
        )

    def held_out_gain(self, causes: Sequence[CurveCause], cause: CurveCause) -> float:
        """Gain in log-likelihood on blocks of 2 h of LST that were not fitted."""
        lst = np.concatenate([self.curve.lst_hours[self.has_point[d]] for d in DIPOLES])
        fold = (lst // 2).astype(int) % FOLDS
        noise = np.concatenate([np.full(int(self.has_point[d].sum()), self.noise_db[d]) for d in DIPOLES])
        gain = 0.0
        for k in range(FOLDS):
            is_test = fold == k
            squares = []
            for chosen in (list(causes), [*causes, cause]):
                fitted = self.fit(chosen, ~is_test)
                left = np.concatenate([fitted.residual_db[d][self.has_point[d]] for d in DIPOLES])
                squares.append(float(np.sum((left[is_test] / noise[is_test]) ** 2)))
            gain += 0.5 * (squares[0] - squares[1])
        return gain

    def calibration_change(self, before: CurveFit, after: CurveFit) -> Floats:
        """Relative change of C: C^2 goes as the LST variation of P_sky, which sets the slope; shape (dipole, freq)."""
        old, new = self.power_with(before.causes, before.sizes), self.power_with(after.causes, after.sizes)
        ratio = [np.std(new[d], axis=0) / np.std(old[d], axis=0) for d in DIPOLES]
        return np.asarray(np.sqrt(ratio) - 1.0)


def describe_curve(found: CurveInvestigation, provenance: Provenance) -> dict[str, Any]:
    """The report of an LST curve as JSON values, in the form of an investigation report."""
    is_left = found.leftover_p < ALPHA_LEFTOVER
    verdict = "unexplained" if is_left else "explained" if found.steps else "consistent"
    return {
        "verdict": verdict,
        "findings": [_finding(found, k) for k in range(len(found.steps))],
        "unexplained": _unexplained(found) if is_left else None,
        "unidentifiable": [
            {"cause": cause, "why": "a band-averaged LST curve has no axis that shows it"} for cause in NEEDS_MORE_AXES
        ],
        "noise": {"point_noise_db": dict(found.point_noise_db)},
        "chi2": {
            "points": found.first.points,
            "before": {"estimated": found.first.chi2, "drawn_bars": found.first.chi2_drawn},
            "after": {"estimated": found.last.chi2, "drawn_bars": found.last.chi2_drawn},
        },
        "scores": [{"cause": cause.label, "chi2_gain": gain} for cause, gain in found.tried],
        "provenance": provenance.as_dict(),
    }


def _finding(found: CurveInvestigation, k: int) -> dict[str, Any]:
    step, last = found.steps[k], found.last
    size, sigma = float(last.sizes[k]), float(last.sigmas[k])
    change = np.abs(step.calibration_change)
    return {
        "cause": step.cause.identifier,
        "indistinguishable": list(dict.fromkeys(c.identifier for c, _ in step.rivals)),
        "size": {"value": size, "sigma": sigma, "unit": step.cause.unit},
        "parameters": dict(step.cause.parameters),
        "significance_sigma": significance(step.z, step.trials),
        "p_value": step.p_value,
        "where": {
            "frequency_mhz": None,
            "lst_h": [0.0, 24.0],
            "utc_h": None,
            "dates": None,
            "antennas": [],
            "dipoles": list(DIPOLES),
        },
        "gain": {
            "chi2_before": step.before.chi2,
            "chi2_after": step.after.chi2,
            "chi2_per_point_drawn_bars": [
                step.before.chi2_drawn / step.before.points,
                step.after.chi2_drawn / step.after.points,
            ],
            "dof": step.after.points - len(DIPOLES) - len(step.after.causes),
            "held_out_log_likelihood_gain": step.held_out_gain,
            "held_out_events": step.after.points,
            "residual_variance_explained": 1.0 - step.after.chi2 / step.before.chi2,
        },
        "calibration_change": {"max_fraction": float(change.max()), "median_fraction": float(np.median(change))},
        "sentence": f"In this curve {step.cause.meaning}: {size:.3g} +- {sigma:.2g} ({step.cause.unit}).",
        "evidence": {
            "confirm": step.cause.confirm,
            "chi2_of_rivals": {c.label: value for c, value in step.rivals},
            "note": "acts by ratio where it needs a direction: P_sky times own(with)/own(without)",
        },
    }


def _unexplained(found: CurveInvestigation) -> dict[str, Any]:
    return {
        "p_value": found.leftover_p,
        "where": {"axis": "lst"},
        "description": "the points scatter about the extended model by more than about a smooth curve: structure in "
        "LST that no cause of the catalogue explains",
        "gain": {"chi2": found.last.chi2, "terms": 0, "held_out_log_likelihood_gain": None},
        "similar_to": [],
    }
