"""The search of a band-averaged LST curve for what its simulation gets wrong: one axis, but published of real data.

The model is the band power of P_sky and electronic noise relative to its level at LST 0, with a free offset for each
dipole. It grows by one cause at a time, as that of spectra does (`lbacal_core.discovery.growth`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtrc
from threadpoolctl import threadpool_limits

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.discovery.curve_fit import (
    GRID_HOURS,
    Choice,
    CurveFit,
    CurveFitter,
    gather_curve,
    list_choices,
    why_not,
)
from lbacal_core.discovery.growth import grow
from lbacal_core.discovery.hypothesis import Rival, p_of, sigma_of
from lbacal_core.discovery.policy import CURVE_POLICY, Policy
from lbacal_core.discovery.report import BY_RATIO, CONSISTENT, EXPLAINED, UNEXPLAINED, tell_finding, tell_gain
from lbacal_core.grids import Floats
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    LstCurve,
    NoisePrior,
    PointNoise,
    band_weights,
    estimate_noise,
    noise_prior,
)
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import FULL_MAPS, model_difference_modes


@dataclass(frozen=True)
class CurveFinding:
    """A cause that was found: the fit without it, and with it replaced by each other cause.

    Attributes
    ----------
    place
        Index of the cause in the last fit.
    rivals
        Every other cause in its place, best first.
    open
        The last fit with each that the data do not exclude in its place.
    indistinguishable
        Other causes among these, with the correlation of the two signatures at the sizes found.
    z
        Standard deviations before the look-elsewhere correction.
    """

    place: int
    without: CurveFit
    rivals: list[Rival]
    open: list[CurveFit]
    indistinguishable: dict[str, float]
    z: float
    p_value: float
    held_out_gain: float


@dataclass(frozen=True)
class CurveInvestigation:
    """The result of a search of an LST curve.

    Attributes
    ----------
    findings
        Most significant first.
    single
        Every cause fitted by itself, best first.
    trials
        Trials factor of the catalogue: number of kinds of causes.
    structure_p
        Probability by which the points scatter as much about the model found.
    unidentifiable
        Causes that a curve can never show, with the reason.
    """

    fitter: CurveFitter
    band_mhz: tuple[float, float]
    first: CurveFit
    last: CurveFit
    findings: list[CurveFinding]
    single: list[CurveFit]
    trials: float
    structure_p: float
    unidentifiable: Mapping[str, str]
    policy: Policy

    @property
    def open(self) -> list[CurveFit]:
        """Sets that the data leave open beside the one named: one of its causes is replaced by another, best first."""
        return sorted((fit for finding in self.findings for fit in finding.open), key=lambda fit: fit.chi2)

    @property
    def hypotheses(self) -> list[tuple[CurveFit, str]]:
        """Every set of causes with its standing: the one named, those left open, and single causes."""
        are_open, last = {fit.labels for fit in self.open}, self.last.labels
        every = {fit.labels: fit for fit in (self.last, *self.open, *self.single) if fit.choices}
        return [
            (fit, "named" if labels == last else "not excluded" if labels in are_open else "excluded")
            for labels, fit in every.items()
        ]


def investigate_curve(
    curve: LstCurve,
    simulation: Simulation,
    band_mhz: tuple[float, float],
    *,
    weights: str = AS_RECORDED,
    noise: PointNoise | None = None,
    prior: NoisePrior | None = None,
    without: str | None = None,
) -> CurveInvestigation:
    """Find what a simulated sky power gets wrong in an LST curve.

    Parameters
    ----------
    simulation
        Where its sky is its own, the spread of sky and antenna models counts as noise.
    weights
        How channels weigh in the band: one of `lstcurve.compare.WEIGHTS`.
    noise
        Noise of the points; estimated where it is not given.
    prior
        What is known of the electronic noise; what is published, where it is not given.
    without
        A kind of cause that is left out: a finding of that kind must fit better than all others.
    """
    policy = CURVE_POLICY
    of_channels = band_weights(simulation.instrument, weights, band_mhz)
    modes = model_difference_modes(simulation.instrument, GRID_HOURS, FULL_MAPS)
    with threadpool_limits(1):  # the arrays are small: threads cost ten times what they gain
        station = gather_curve(
            simulation, of_channels, prior or noise_prior(simulation.instrument, band_mhz, of_channels)
        )
        fitter = CurveFitter(curve, station, noise or estimate_noise(curve), modes if simulation.is_own_sky else None)
        choices = list_choices(station)
        search = _Search(fitter, [choice for choice in choices if without not in choice.kinds], policy)
        first = fitter.fit([])
        single = search.extended(first)
        steps = grow(first, search, policy.most_findings)
        last = steps[-1].candidate if steps else first
        findings = [search.finding(last, place) for place in range(len(last.choices))]
    return CurveInvestigation(
        fitter,
        band_mhz,
        first,
        last,
        sorted(findings, key=lambda finding: -finding.z),
        single,
        search.trials,
        float(fdtrc(last.dof, fitter.noise.free, last.chi2 / last.dof)),
        why_not(station, choices),
        policy,
    )


class _Search:
    """The search of one curve as `grow` wants it."""

    def __init__(self, fitter: CurveFitter, choices: Sequence[Choice], policy: Policy) -> None:
        self.fitter, self.choices, self.policy = fitter, choices, policy
        self.trials = float(len({kind for choice in choices for kind in choice.kinds}))

    def extended(self, before: CurveFit) -> list[CurveFit]:
        """The causes of a fit with each one more whose kinds it does not contain, fitted, best first."""
        taken = {kind for choice in before.choices for kind in choice.kinds}
        start = dict(zip(before.labels, before.sizes.tolist(), strict=True))
        fits = []
        for new in self.choices:
            if not taken & new.kinds:
                chosen = {*before.labels, new.label}
                fits.append(self.fitter.fit([one for one in self.choices if one.label in chosen], start=start))
        # Fits of equal chi^2 keep the order of the catalogue.
        return sorted(fits, key=lambda fit: round(fit.chi2, 2))

    def propose(self, before: CurveFit) -> list[CurveFit]:
        """The best fits with one cause more that are named and better than chance over the whole catalogue allows."""
        named = [
            fit
            for fit in self.extended(before)
            if not (fit.is_at_edge or any(choice.is_alias for choice in fit.choices))
        ]
        return [
            fit for fit in named[: self.policy.rivals] if self.p_value(before, fit)[1] < self.policy.catalogue_alpha
        ]

    def model_of(self, candidate: CurveFit) -> CurveFit:
        """A candidate is its own model."""
        return candidate

    def held_out_gain(self, before: CurveFit, candidate: CurveFit) -> float:
        """Gain in log-likelihood on blocks of LST that were not fitted."""
        return self.fitter.held_out_gain(before, candidate)

    def p_value(self, fewer: CurveFit, more: CurveFit) -> tuple[float, float]:
        """Significance of one cause more, standard deviations, and its p-value over the whole catalogue.

        The noise level comes from the scatter of the points, or from the residuals of the larger set: the gain in
        chi^2 follows an F, not a chi^2 distribution.
        """
        gain = max(fewer.chi2 - more.chi2, 0.0) / more.scale
        z = sigma_of(float(fdtrc(1, self.fitter.noise.free, gain)))
        return z, p_of(z, self.trials)

    def finding(self, last: CurveFit, place: int) -> CurveFinding:
        """One cause of the set, with its gain in chi^2 and the causes that could replace it."""
        choice = last.choices[place]
        others = [one for one in last.choices if one is not choice]
        without = self.fitter.fit(others, start=dict(zip(last.labels, last.sizes.tolist(), strict=True)))
        own = self.fitter.signature(without, last)
        separable = (without.chi2 - last.chi2) / last.scale
        rivals, still_open, alike = list[Rival](), list[CurveFit](), dict[str, float]()
        for fit in self.extended(without):
            (new,) = (one for one in fit.choices if one.label not in without.labels)
            if new.label == choice.label:
                continue
            other = self.fitter.signature(without, fit)
            scale = float(np.sqrt((own @ own) * (other @ other)))
            r = float(own @ other) / scale if scale > 0 else 0.0
            rival = Rival(new.cause.identifier, "curve", (fit.chi2 - last.chi2) / last.scale)
            rivals.append(rival)
            if min(rival.delta_chi2, separable * (1 - r**2)) < self.policy.indistinguishable:
                still_open.append(fit)
                alike |= {rival.cause: r} if rival.cause != choice.cause.identifier else {}
        z, p_value = self.p_value(without, last)
        gain = self.fitter.held_out_gain(without, last)
        return CurveFinding(place, without, rivals, still_open, alike, z, p_value, gain)


# The report of an LST curve as JSON values: the fields of docs/formats/investigation-report.md.

REPORTED_MHZ = (30.0, 40.0, 50.0, 55.0, 60.0, 70.0, 80.0)
AS_PUBLISHED = 2.0
"""Standard deviations of the prior within which a fitted noise is the published one."""


def describe_curve(found: CurveInvestigation, provenance: Provenance) -> dict[str, Any]:
    """The report of an LST curve as JSON values (docs/formats/investigation-report.md)."""
    first, last = found.first, found.last
    is_left = found.structure_p < found.policy.structure_alpha
    verdict = UNEXPLAINED if is_left else EXPLAINED if found.findings else CONSISTENT
    findings = [_finding(found, finding) for finding in found.findings]
    return {
        "verdict": verdict,
        "sentence": _summary(found, verdict),
        "findings": [] if is_left else findings,
        "unexplained": _unexplained(found, findings) if is_left else None,
        "unidentifiable": [{"cause": cause, "why": why} for cause, why in sorted(found.unidentifiable.items())],
        "noise": _noise(found),
        "chi2": {
            "points": first.points,
            "before": {"estimated": first.chi2, "drawn_bars": first.chi2_drawn},
            "after": {"estimated": last.chi2, "drawn_bars": last.chi2_drawn},
            "per_point_before": first.per_point,
            "per_point_after": last.per_point,
            "scale": last.scale,
        },
        "hypotheses": [_hypothesis(found, *one) for one in found.hypotheses],
        "scores": [
            {"cause": fit.labels[0], "chi2_gain": first.chi2 - fit.chi2, "size": float(fit.sizes[0])}
            for fit in found.single
        ],
        "provenance": {**provenance.as_dict(), "judge": "search"},
    }


def _summary(found: CurveInvestigation, verdict: str) -> str:
    noise = _noise_words(found)
    if not found.findings:
        what = "The points and the simulation agree" if verdict == CONSISTENT else "No cause of the catalogue helps"
        return f"{what}, with {noise}."
    names = "; ".join(_words(found.last, one.place) for one in found.findings)
    if verdict == UNEXPLAINED:
        names = f"residual structure in LST remains beside what describes most of it, {names}"
    before, after = found.first.per_point, found.last.per_point
    return (
        f"What the simulation gets wrong: {names}. With {noise}, chi^2 per point falls from "
        f"{before['estimated']:.1f} to {after['estimated']:.1f} with the estimated noise of the points, "
        f"from {before['drawn_bars']:.1f} to {after['drawn_bars']:.1f} with the drawn bars."
    )


def _noise_words(found: CurveInvestigation) -> str:
    last, prior = found.last, found.fitter.station.prior
    words = f"electronic noise of {last.noise:.2f} ± {last.noise_sigma:.2f} of the mean sky power"
    if not prior.is_known:
        return words
    is_as_published = abs(last.noise - prior.mean) < AS_PUBLISHED * prior.sigma
    known = f"{prior.mean:.2f} ± {prior.sigma:.2f}"
    return f"{words}, as published ({known})" if is_as_published else f"{words}, where {known} is published"


def _cause(fit: CurveFit, place: int) -> dict[str, Any]:
    """One cause of a set with its size; what the fit leaves widens the error, and a statement has none."""
    choice, size = fit.choices[place], float(fit.sizes[place])
    sigma = None if choice.is_statement else float(fit.sigmas[place] * np.sqrt(fit.scale)) * choice.scale
    relative = {"fraction_of_mean_sky_power": size} if choice.scale != 1 else {}
    return {
        "cause": choice.cause.identifier,
        "size": {"value": size * choice.scale, "sigma": sigma, "unit": choice.cause.unit},
        "parameters": {**choice.template.parameters, **relative},
        "is_at_edge_of_its_range": not choice.is_statement and choice.sizes.is_at_edge(size),
        "would_decide": choice.cause.confirm,
    }


def _words(fit: CurveFit, place: int) -> str:
    choice, size = fit.choices[place], _cause(fit, place)["size"]
    if choice.is_statement:
        return f"{choice.cause.whole_array_meaning} ({choice.label})"
    share = f", {fit.sizes[place]:.2f} of the mean sky power" if choice.scale != 1 else ""
    value = f"{size['value']:.3g} ± {size['sigma']:.2g} {size['unit']}"
    return f"{choice.cause.meaning} ({choice.label} {value}{share})"


def _noise(found: CurveInvestigation) -> dict[str, Any]:
    curve, noise, prior, last = found.fitter.curve, found.fitter.noise, found.fitter.station.prior, found.last
    return {
        "of_mean_sky_power": {
            "value": last.noise,
            "sigma": last.noise_sigma,
            "share": last.noise / (1.0 + last.noise),
            "prior": {"value": prior.mean, "sigma": prior.sigma} if prior.is_known else None,
        },
        "point_noise_db": dict(noise.sigma_db),
        "correlation_of_x_and_y": noise.correlation,
        "degrees_of_freedom": noise.free,
        "drawn_bar_db": float(np.nanmedian(curve.error_db)),
        "spread_of_models_added": found.fitter.has_model_spread,
        "lst_convention": "bin centre, stated"
        if curve.is_centre_stated
        else f"left edge, assumed: half a bin, {curve.bin_hours / 2:g} h, is a systematic uncertainty of lst_offset",
    }


def _finding(found: CurveInvestigation, finding: CurveFinding) -> dict[str, Any]:
    last, place = found.last, finding.place
    cause, one = last.choices[place].cause, _cause(last, place)
    change = found.fitter.calibration_change(finding.without, last)
    told = tell_finding(
        cause,
        indistinguishable=list(finding.indistinguishable.items()),
        size=(one["size"]["value"], one["size"]["sigma"]),
        parameters=one["parameters"],
        chance=(sigma_of(finding.p_value), finding.p_value),
        where={
            **dict.fromkeys(("station", "lst_h", "utc_h", "dates")),
            "frequency_mhz": list(found.band_mhz),
            "antennas": [],
            "dipoles": list(DIPOLES),
        },
        gain=tell_gain(finding.without.chi2, last.chi2, last.dof, finding.held_out_gain, last.points)
        | {"chi2_per_point_before": finding.without.per_point, "chi2_per_point_after": last.per_point},
        change=np.concatenate([change[d] for d in DIPOLES]),
        sentence=f"In this curve {_words(last, place)}, with {_noise_words(found)}.",
        evidence={
            "score_sigma": finding.z,
            "trials": found.trials,
            "correlations": finding.indistinguishable,
            "note": BY_RATIO if cause.acts_by_ratio else "",
            "rivals": [one.as_dict() for one in finding.rivals],
        },
    )
    return {**told, "calibration_change": {**told["calibration_change"], **_change(found, change)}}


def _hypothesis(found: CurveInvestigation, fit: CurveFit, standing: str) -> dict[str, Any]:
    """One set of causes with its fit and its change of C(nu)."""
    return {
        "causes": [_cause(fit, place) for place in range(len(fit.choices))],
        "standing": standing,
        "chi2": fit.chi2,
        "dof": fit.dof,
        "chi2_per_point": fit.per_point,
        "chi2_above_named": fit.chi2 - found.last.chi2,
        "calibration_change": _change(found, found.fitter.calibration_change(found.first, fit)),
    }


def _change(found: CurveInvestigation, change: dict[str, Floats]) -> dict[str, Any]:
    """C with over C without, minus 1, for each dipole."""
    frequency = found.fitter.station.channels_mhz
    shown = [nu for nu in REPORTED_MHZ if frequency[0] <= nu <= frequency[-1]]
    return {
        d: {
            "median_fraction": float(np.median(change[d])),
            "at_mhz": {f"{nu:g}": float(np.interp(nu, frequency, change[d])) for nu in shown},
        }
        for d in DIPOLES
    }


def _unexplained(found: CurveInvestigation, findings: list[dict[str, Any]]) -> dict[str, Any]:
    """Residual structure, and the causes that describe a part of it: all act along the one axis that there is."""
    return {
        "p_value": found.structure_p,
        "where": {"station": None, "axis": "lst", "target": None, "frequency_mhz": list(found.band_mhz), "dates": None},
        "description": "the points scatter about the causes found by more than about a smooth curve: residual "
        "structure in LST that no cause of the catalogue describes; it widens the errors of the sizes",
        "gain": {"chi2": found.last.chi2, "terms": 0, "held_out_log_likelihood_gain": None},
        "similar_to": findings,
    }
