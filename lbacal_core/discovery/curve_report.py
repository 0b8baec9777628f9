"""The report of an LST curve as JSON values, with the fields of an investigation report (docs/formats.md)."""

from __future__ import annotations

from typing import Any

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.lst_curve import CurveFinding, CurveInvestigation
from lbacal_core.discovery.report import BY_RATIO, CONSISTENT, EXPLAINED, UNEXPLAINED, tell_finding, tell_gain
from lbacal_core.discovery.trials import sigma_of
from lbacal_core.grids import Floats
from lbacal_core.provenance import Provenance

REPORTED_MHZ = (30.0, 40.0, 50.0, 55.0, 60.0, 70.0, 80.0)
AS_PUBLISHED = 2.0
"""Standard deviations of the prior within which a fitted noise is the published one."""


def describe_curve(found: CurveInvestigation, provenance: Provenance) -> dict[str, Any]:
    """The report of an LST curve."""
    first, last = found.first, found.last
    is_left = found.structure_p < found.policy.structure_alpha
    verdict = UNEXPLAINED if is_left else EXPLAINED if found.findings else CONSISTENT
    findings = [_finding(found, finding) for finding in found.findings]
    shown = {fit.labels: fit for fit in (last, *found.open, *found.single) if fit.choices}
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
        "hypotheses": [_hypothesis(found, fit) for fit in shown.values()],
        "scores": [
            {"cause": fit.labels[0], "chi2_gain": first.chi2 - fit.chi2, "size": float(fit.sizes[0])}
            for fit in found.single
        ],
        "provenance": provenance.as_dict(),
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
    cause, one = finding.choice.cause, _cause(last, place)
    change = found.fitter.calibration_change(finding.without, last)
    others = {r.cause: r.correlation for r in finding.rivals if not r.is_excluded and r.cause != cause.identifier}
    told = tell_finding(
        cause,
        indistinguishable=list(others.items()),
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
            "correlations": others,
            "note": BY_RATIO if cause.acts_by_ratio else "",
        },
    )
    return {**told, "calibration_change": {**told["calibration_change"], **_change(found, change)}}


def _hypothesis(found: CurveInvestigation, fit: CurveFit) -> dict[str, Any]:
    """One set of causes with its fit and its change of C(nu)."""
    is_named = fit.labels == found.last.labels
    is_open = any(fit.labels == one.labels for one in found.open)
    return {
        "causes": [_cause(fit, place) for place in range(len(fit.choices))],
        "standing": "named" if is_named else "not excluded" if is_open else "excluded",
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
