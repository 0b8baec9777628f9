"""The report of an investigation as JSON values (docs/formats.md) and in plain sentences; it computes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.residual_structure import ResidualStructure
from lbacal_core.discovery.scan import Score
from lbacal_core.discovery.search import Finding, StationReport
from lbacal_core.discovery.trials import sigma_of
from lbacal_core.provenance import Provenance

CONSISTENT, EXPLAINED, UNEXPLAINED = "consistent", "explained", "unexplained"
NOISY = 1.1
"""Noise of a path over the typical one beyond which the report names the path."""


def describe(reports: Sequence[StationReport], provenance: Provenance) -> dict[str, Any]:
    """The report of all stations as JSON values."""
    findings = [_finding(f, report) for report in reports for f in report.findings]
    findings += [_antenna_finding(score, report) for report in reports for score in report.antennas]
    findings.sort(key=lambda finding: -finding["significance_sigma"])
    left = [(report, report.structure) for report in reports if report.structure is not None]
    unexplained = None
    if left:
        report, structure = min(left, key=lambda item: item[1].p_value)
        unexplained = _unexplained(structure, report)
    verdict = UNEXPLAINED if unexplained else EXPLAINED if findings else CONSISTENT
    reasons: dict[str, str] = {}
    for report in reports:
        reasons.update(report.unidentifiable)
    return {
        "verdict": verdict,
        "findings": findings,
        "unexplained": unexplained,
        "unidentifiable": [{"cause": cause, "why": why} for cause, why in sorted(reasons.items())],
        "noise": {report.station.name: _noise(report) for report in reports},
        "scores": {report.station.name: _scores(report) for report in reports},
        "provenance": provenance.as_dict(),
    }


def _noise(report: StationReport) -> dict[str, Any]:
    station, levels = report.station, report.last.linear.residuals.levels
    return {
        "radiometer_per_mhz": levels.path_channel,
        "path_event_gain": levels.path_band,
        "station_event_gain": levels.common_sum / 2**0.5,
        "common_per_mhz": levels.common_channel.tolist(),
        "noisy_paths": [
            {"antenna": int(a), "dipole": str(d), "scale": float(s)}
            for a, d, s in zip(station.antenna, station.dipole, levels.path_scale, strict=True)
            if s > NOISY
        ],
    }


def _scores(report: StationReport) -> list[dict[str, Any]]:
    scores: list[Score | AntennaScore] = [*report.scores, *report.antenna_scores]
    return [
        {
            "cause": score.cause.identifier,
            "target": score.target.label,
            "parameters": plain_parameters(score.parameters),
            "score_sigma": float(score.z),
            "size": float(score.size),
            "p_value": float(score.p_value),
        }
        for score in scores
    ]


def _finding(finding: Finding, report: StationReport) -> dict[str, Any]:
    one, cause, score = finding.hypothesis, finding.hypothesis.cause, finding.score
    change = np.abs(finding.calibration_change)
    return {
        "cause": cause.identifier,
        "indistinguishable": [name for name, _ in finding.indistinguishable],
        "size": {"value": one.size, "sigma": one.uncertainty, "unit": cause.unit},
        "parameters": plain_parameters(one.template.parameters),
        "significance_sigma": score.significance,
        "p_value": score.p_value,
        "where": _where(one, report),
        "gain": {
            "chi2_before": finding.chi2_before,
            "chi2_after": finding.chi2_after,
            "dof": finding.dof,
            "held_out_log_likelihood_gain": finding.held_out_gain,
            "held_out_events": int(report.station.event_id.size),
            "residual_variance_explained": (finding.chi2_before - finding.chi2_after) / finding.chi2_before,
        },
        "calibration_change": {"max_fraction": float(change.max()), "median_fraction": float(np.median(change))},
        "sentence": _sentence(one, report),
        "evidence": {
            "score_sigma": float(score.z),
            "trials": float(score.trials),
            "confirm": cause.confirm,
            "target": one.target.label,
            "sigma_of_size_under_this_law": one.sigma,
            "is_converged": report.last.is_converged,
            "correlations": dict(finding.indistinguishable),
            "note": "acts by ratio: P_sky times own(with)/own(without), from the package's own sky and antenna model"
            if cause.acts_by_ratio
            else "",
        },
    }


def _where(one: Hypothesis, report: StationReport) -> dict[str, Any]:
    station, parameters = report.station, one.template.parameters
    frequency, times = station.conditions.frequency_mhz, station.conditions.time_unix
    line = parameters.get("frequency_mhz")
    hours = parameters.get("utc_h", [0, 24])
    members = one.target.is_member
    return {
        "station": station.name,
        "frequency_mhz": [float(frequency[0]), float(frequency[-1])] if line is None else [line - 0.5, line + 0.5],
        "lst_h": [0.0, 24.0],
        "utc_h": [float(hours[0]), float(hours[1])],
        "dates": [_date(parameters.get("date_unix", float(times.min()))), _date(float(times.max()))],
        "antennas": sorted({int(a) for a in station.antenna[members]}),
        "dipoles": sorted({str(d) for d in station.dipole[members]}),
    }


def _sentence(one: Hypothesis, report: StationReport) -> str:
    whom = f"station {report.station.name}"
    if one.target.scope != "station":
        whom += f", {one.target.label}"
    size = f"{one.size:.3g} +- {one.uncertainty:.2g} ({one.cause.unit})"
    return f"In {whom}, {one.cause.meaning}: {size}{_with(one.template.parameters)}."


def _with(parameters: Mapping[str, Any]) -> str:
    words = "; ".join(f"{key} {value}" for key, value in plain_parameters(parameters).items() if key != "date_unix")
    return f" with {words}" if words else ""


def _antenna_finding(score: AntennaScore, report: StationReport) -> dict[str, Any]:
    station, members = report.station, score.target.is_member
    change = np.abs(0.5 * score.size * (score.departure - score.departure.mean()))
    frequency, times = station.conditions.frequency_mhz, station.conditions.time_unix
    return {
        "cause": score.cause.identifier,
        "indistinguishable": [name for name, _ in score.similar],
        "size": {"value": score.size, "sigma": score.sigma, "unit": score.cause.unit},
        "parameters": plain_parameters(score.parameters),
        "significance_sigma": sigma_of(score.p_value),
        "p_value": score.p_value,
        "where": {
            "station": station.name,
            "frequency_mhz": [float(frequency[0]), float(frequency[-1])],
            "lst_h": [0.0, 24.0],
            "utc_h": [0.0, 24.0],
            "dates": [_date(float(times.min())), _date(float(times.max()))],
            "antennas": sorted({int(a) for a in station.antenna[members]}),
            "dipoles": sorted({str(d) for d in station.dipole[members]}),
        },
        "gain": {
            "chi2_before": score.z**2,
            "chi2_after": 0.0,
            "dof": int(frequency.size - 1),
            "held_out_log_likelihood_gain": None,
            "held_out_events": 0,
            "residual_variance_explained": None,
        },
        "calibration_change": {"max_fraction": float(change.max()), "median_fraction": float(np.median(change))},
        "sentence": f"In station {station.name}, {score.target.label}, {score.cause.meaning}: "
        f"{score.size:.3g} +- {score.sigma:.2g} ({score.cause.unit}){_with(score.parameters)}.",
        "evidence": {
            "score_sigma": score.z,
            "trials": score.trials,
            "confirm": score.cause.confirm,
            "target": score.target.label,
            "correlations": dict(score.similar),
            "note": score.cause.note(score.parameters, score.size),
        },
    }


def _unexplained(structure: ResidualStructure, report: StationReport) -> dict[str, Any]:
    station = report.station
    frequency, times = station.conditions.frequency_mhz, station.conditions.time_unix
    strong = frequency[structure.channel_share > 0.5 * structure.channel_share.max()]
    return {
        "p_value": structure.p_value,
        "where": {
            "station": station.name,
            "axis": structure.axis_name,
            "target": structure.target,
            "frequency_mhz": [float(strong.min()), float(strong.max())],
            "dates": [_date(float(times.min())), _date(float(times.max()))],
        },
        "description": f"structure along {structure.axis_name} in {structure.target} of {station.name} that no cause "
        f"of the catalogue explains, strongest at {strong.min():.0f}-{strong.max():.0f} MHz",
        "gain": {
            "chi2": structure.gain,
            "terms": structure.dof,
            "held_out_log_likelihood_gain": structure.held_out_gain,
        },
        "similar_to": [_finding(finding, report) for finding in report.similar],
    }


def _date(time_unix: float) -> str:
    return f"{datetime.fromtimestamp(time_unix, UTC):%Y-%m-%dT%H:%M:%SZ}"


def plain_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as JSON values, an instant also in words."""
    values = {key: value.item() if isinstance(value, np.generic) else value for key, value in parameters.items()}
    if "date_unix" in values:
        values["date"] = f"{datetime.fromtimestamp(values['date_unix'], UTC):%Y-%m-%dT%H:%MZ}"
    return values
