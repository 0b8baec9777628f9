"""The report of an LST curve as JSON values, in the form of an investigation report (docs/formats.md)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.curve_station import Choice
from lbacal_core.discovery.lst_curve import CurveFinding, CurveInvestigation, Rival
from lbacal_core.discovery.trials import sigma_of
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES
from lbacal_core.lstcurve.noise import PointNoise
from lbacal_core.provenance import Provenance

REPORTED_MHZ = (30.0, 40.0, 50.0, 55.0, 60.0, 70.0, 80.0)
MOST_ALTERNATIVES = 12


def describe_curve(found: CurveInvestigation, provenance: Provenance) -> dict[str, Any]:
    """The report of an LST curve."""
    is_left = found.structure_p < found.policy.structure_alpha
    verdict = "unexplained" if is_left else "explained" if found.findings else "consistent"
    hypotheses = [found.last, *found.alternatives[:MOST_ALTERNATIVES], *found.single]
    distinct = {fit.labels: fit for fit in reversed(hypotheses) if fit.choices}
    ordered = [fit for fit in dict.fromkeys(fit.labels for fit in hypotheses) if fit in distinct]
    return {
        "verdict": verdict,
        "sentence": _summary(found, verdict),
        "findings": [_finding(found, finding) for finding in found.findings],
        "unexplained": _unexplained(found) if is_left else None,
        "unidentifiable": [{"cause": cause, "why": why} for cause, why in found.unidentifiable.items()],
        "noise": _noise(found.fitter.noise, found),
        "chi2": {
            "points": found.first.points,
            "before": {"estimated": found.first.chi2, "drawn_bars": found.first.chi2_drawn},
            "after": {"estimated": found.last.chi2, "drawn_bars": found.last.chi2_drawn},
            "per_point_before": _per_point(found.first),
            "per_point_after": _per_point(found.last),
            "scale": found.last.scale,
        },
        "hypotheses": [_hypothesis(found, distinct[labels]) for labels in ordered],
        "scores": [
            {"cause": fit.labels[0], "chi2_gain": found.first.chi2 - fit.chi2, "size": float(fit.sizes[0])}
            for fit in found.single
        ],
        "provenance": provenance.as_dict(),
    }


def _summary(found: CurveInvestigation, verdict: str) -> str:
    if not found.findings:
        return "The points and the simulation agree." if verdict == "consistent" else "No cause of the catalogue helps."
    names = "; ".join(_words(one.choice, found.last, one.place) for one in found.findings)
    before, after = _per_point(found.first), _per_point(found.last)
    return (
        f"What the simulation gets wrong: {names}. Chi^2 per point falls from {before['estimated']:.1f} to "
        f"{after['estimated']:.1f} with the estimated noise, from {before['drawn_bars']:.1f} to "
        f"{after['drawn_bars']:.1f} with the drawn bars."
    )


def _words(choice: Choice, fit: CurveFit, place: int) -> str:
    size, sigma = _size(choice, fit, place)
    share = f", {fit.sizes[place]:.2f} of the mean sky power" if choice.scale != 1 else ""
    return f"{choice.cause.meaning} ({choice.label} {size:.3g} +- {sigma:.2g} {choice.cause.unit}{share})"


def _size(choice: Choice, fit: CurveFit, place: int) -> tuple[float, float]:
    """Size and its standard deviation in the cause's unit, multiplied by the scale factor of the fit."""
    scale = choice.scale * float(np.sqrt(fit.scale))
    return float(fit.sizes[place]) * choice.scale, float(fit.sigmas[place]) * scale


def _parameters(choice: Choice, fit: CurveFit, place: int) -> dict[str, Any]:
    relative = {"fraction_of_mean_sky_power": float(fit.sizes[place])} if choice.scale != 1 else {}
    return {**choice.template.parameters, **relative}


def _per_point(fit: CurveFit) -> dict[str, float]:
    return {"estimated": fit.chi2 / fit.points, "drawn_bars": fit.chi2_drawn / fit.points}


def _noise(noise: PointNoise, found: CurveInvestigation) -> dict[str, Any]:
    return {
        "point_noise_db": dict(noise.sigma_db),
        "correlation_of_x_and_y": noise.correlation,
        "degrees_of_freedom": noise.free,
        "drawn_bar_db": float(np.nanmedian(found.fitter.curve.error_db)),
        "spread_of_models_added": found.fitter.has_model_spread,
        "lst_convention": "bin centre, stated"
        if found.fitter.curve.is_centre_stated
        else "left edge, assumed: half a bin, "
        f"{found.fitter.curve.bin_hours / 2:g} h, is a systematic uncertainty of lst_offset",
    }


def _finding(found: CurveInvestigation, finding: CurveFinding) -> dict[str, Any]:
    last, choice, cause = found.last, finding.choice, finding.choice.cause
    size, sigma = _size(choice, last, finding.place)
    change = found.fitter.calibration_change(_less(last, finding.place), last)
    every = np.abs(np.concatenate([change[d] for d in DIPOLES]))
    names = [rival.choice.cause.identifier for rival in finding.rivals if not rival.is_excluded]
    return {
        "cause": cause.identifier,
        "indistinguishable": [name for name in dict.fromkeys(names) if name != cause.identifier],
        "size": {"value": size, "sigma": sigma, "unit": cause.unit},
        "parameters": _parameters(choice, last, finding.place),
        "significance_sigma": sigma_of(finding.p_value),
        "p_value": finding.p_value,
        "where": {
            "frequency_mhz": list(found.band_mhz),
            "lst_h": [0.0, 24.0],
            "utc_h": None,
            "dates": None,
            "antennas": [],
            "dipoles": list(DIPOLES),
        },
        "gain": {
            "chi2_before": finding.without.chi2,
            "chi2_after": last.chi2,
            "chi2_per_point_before": _per_point(finding.without),
            "chi2_per_point_after": _per_point(last),
            "dof": last.dof,
            "held_out_log_likelihood_gain": finding.held_out_gain,
            "held_out_events": last.points,
            "residual_variance_explained": 1.0 - last.chi2 / finding.without.chi2,
        },
        "calibration_change": {
            "max_fraction": float(every.max()),
            "median_fraction": float(np.median(every)),
            **_change(found, change),
        },
        "sentence": f"In this curve {_words(choice, last, finding.place)}.",
        "evidence": {
            "score_sigma": finding.z,
            "would_decide": cause.confirm,
            "in_its_place": [_rival(last, rival) for rival in finding.rivals],
            "note": "causes that need a direction act by ratio: P_sky times own(with)/own(without)",
        },
    }


def _less(fit: CurveFit, place: int) -> CurveFit:
    """The set without one of its causes, the others unchanged: the difference is the effect of that cause alone."""
    choices = fit.choices[:place] + fit.choices[place + 1 :]
    return replace(fit, choices=choices, sizes=np.delete(fit.sizes, place), sigmas=np.delete(fit.sigmas, place))


def _rival(last: CurveFit, rival: Rival) -> dict[str, Any]:
    place = rival.fit.choices.index(rival.choice)
    size, _ = _size(rival.choice, rival.fit, place)
    return {
        "cause": rival.choice.label,
        "size": size,
        "unit": rival.choice.cause.unit,
        "chi2": rival.fit.chi2,
        "chi2_above_named": rival.fit.chi2 - last.chi2,
        "chi2_drawn_bars_above_named": rival.fit.chi2_drawn - last.chi2_drawn,
        "correlation": rival.correlation,
        "is_excluded": rival.is_excluded,
        "is_at_edge_of_its_range": rival.choice.sizes.is_at_edge(float(rival.fit.sizes[place])),
        "would_decide": rival.choice.cause.confirm,
    }


def _hypothesis(found: CurveInvestigation, fit: CurveFit) -> dict[str, Any]:
    """One set of causes: its sizes, how well it fits, and how C(nu) would change."""
    causes = []
    for place, choice in enumerate(fit.choices):
        size, sigma = _size(choice, fit, place)
        causes.append(
            {
                "cause": choice.cause.identifier,
                "size": {"value": size, "sigma": sigma, "unit": choice.cause.unit},
                "parameters": _parameters(choice, fit, place),
                "is_at_edge_of_its_range": choice.sizes.is_at_edge(float(fit.sizes[place])),
                "would_decide": choice.cause.confirm,
            }
        )
    is_named = fit.labels == found.last.labels
    return {
        "causes": causes,
        "standing": "named" if is_named else "not excluded" if found.is_open(fit) else "excluded",
        "chi2": fit.chi2,
        "dof": fit.dof,
        "chi2_per_point": _per_point(fit),
        "chi2_above_named": fit.chi2 - found.last.chi2,
        "calibration_change": _change(found, found.fitter.calibration_change(found.first, fit)),
    }


def _change(found: CurveInvestigation, change: dict[str, Floats]) -> dict[str, Any]:
    """C with over C without, minus 1, of each dipole."""
    frequency = found.fitter.station.channels_mhz
    shown = [nu for nu in REPORTED_MHZ if frequency[0] <= nu <= frequency[-1]]
    return {
        d: {
            "median_fraction": float(np.median(change[d])),
            "at_mhz": {f"{nu:g}": float(np.interp(nu, frequency, change[d])) for nu in shown},
        }
        for d in DIPOLES
    }


def _unexplained(found: CurveInvestigation) -> dict[str, Any]:
    return {
        "p_value": found.structure_p,
        "where": {"axis": "lst"},
        "description": "the points scatter about the extended model by more than about a smooth curve: structure in "
        "LST that no set of up to four causes describes to the noise; the sizes are widened by its scatter",
        "gain": {"chi2": found.last.chi2, "terms": 0, "held_out_log_likelihood_gain": None},
        "similar_to": [],
    }
