"""The report of an investigation as JSON values (docs/formats.md) and in plain sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.discovery.baseline import gather_stations, model_modes
from lbacal_core.discovery.chance import sigma_of
from lbacal_core.discovery.extend import Effect
from lbacal_core.discovery.investigate import (
    FALSE_ALARM_RATE,
    Finding,
    StationReport,
    investigate_station,
)
from lbacal_core.discovery.leftover import Leftover
from lbacal_core.discovery.scan import Score
from lbacal_core.discovery.statics import StaticScore
from lbacal_core.grids import require_same_grid
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra

CONSISTENT, EXPLAINED, UNEXPLAINED = "consistent", "explained", "unexplained"


def investigate(
    spectra: Spectra,
    instrument: Instrument,
    sky_power: SkyPower,
    *,
    is_own_sky: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[dict[str, Any], list[StationReport]]:
    """Ask every station's spectra what the simulation gets wrong.

    Parameters
    ----------
    is_own_sky
        Whether `sky_power` is the package's own, so that the differences between sky and antenna models are projected
        out; a sky power that was given is taken at its word.

    Returns
    -------
    The report as JSON values, and what it was made from.
    """
    require_same_grid(spectra.origin, spectra.frequency_mhz, instrument.frequency_mhz, f"instrument {instrument.name}")
    require_same_grid(
        sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, f"instrument {instrument.name}"
    )
    # Many small products: threads of the linear algebra would only wait for each other.
    with threadpool_limits(1):
        stations = gather_stations(spectra, instrument, sky_power)
        reports = [
            investigate_station(
                data,
                modes=model_modes(data, instrument) if is_own_sky else None,
                stations=len(stations),
                seed=seed,
                progress=progress,
            )
            for data in stations
        ]
    provenance = Provenance(
        inputs={"spectra": spectra.digest(), "instrument": instrument.digest(), "sky_power": sky_power.digest()},
        settings={"false_alarm_rate": FALSE_ALARM_RATE, "seed": seed, "own_sky": is_own_sky},
    )
    return describe(reports, provenance), reports


def describe(reports: Sequence[StationReport], provenance: Provenance) -> dict[str, Any]:
    """The report of all stations as JSON values."""
    findings = [_finding(f, report) for report in reports for f in report.findings]
    findings += [_static_finding(score, report) for report in reports for score in report.static]
    findings.sort(key=lambda finding: -finding["significance_sigma"])
    left = [(report, report.leftover) for report in reports if report.leftover is not None]
    unexplained = None
    if left:
        report, leftover = min(left, key=lambda item: item[1].p_value)
        unexplained = _unexplained(leftover, report)
    verdict = UNEXPLAINED if unexplained else EXPLAINED if findings else CONSISTENT
    reasons: dict[str, str] = {}
    for report in reports:
        reasons.update(report.unidentifiable)
    return {
        "verdict": verdict,
        "findings": findings,
        "unexplained": unexplained,
        "unidentifiable": [{"cause": cause, "why": why} for cause, why in sorted(reasons.items())],
        "noise": {report.data.station: _noise(report) for report in reports},
        "scores": {report.data.station: _scores(report) for report in reports},
        "provenance": provenance.as_dict(),
    }


def _noise(report: StationReport) -> dict[str, Any]:
    levels = report.last.residuals.levels
    return {
        "radiometer_per_mhz": levels.path_channel,
        "path_event_gain": levels.path_band,
        "station_event_gain": levels.common_sum / 2**0.5,
        "common_per_mhz": levels.common_channel.tolist(),
        "noisy_paths": [
            {"antenna": int(a), "dipole": str(d), "scale": float(s)}
            for a, d, s in zip(report.data.antenna, report.data.dipole, levels.path_scale, strict=True)
            if s > 1.1
        ],
    }


def _scores(report: StationReport) -> list[dict[str, Any]]:
    scores: list[Score | StaticScore] = [*report.first_scan, *report.static_scan]
    return [
        {
            "cause": score.cause.identifier,
            "target": score.target.label,
            "parameters": _plain(score.parameters),
            "score_sigma": float(score.z),
            "size": float(score.size),
            "p_value": float(score.p_value),
        }
        for score in scores
    ]


def _finding(finding: Finding, report: StationReport) -> dict[str, Any]:
    effect = finding.effect
    change = np.abs(finding.calibration_change)
    explained = finding.chi2_before - finding.chi2_after
    return {
        "cause": effect.cause.identifier,
        "indistinguishable": [name for name, _ in finding.indistinguishable],
        "size": {"value": effect.size, "sigma": effect.uncertainty, "unit": effect.cause.unit},
        "parameters": _plain(effect.law.parameters),
        "significance_sigma": finding.significance,
        "p_value": finding.p_value,
        "where": _where(effect, report),
        "gain": {
            "chi2_before": finding.chi2_before,
            "chi2_after": finding.chi2_after,
            "dof": finding.dof,
            "held_out_log_likelihood_gain": finding.held_out_gain,
            "held_out_events": finding.held_out_events,
            "residual_variance_explained": explained / finding.chi2_before,
        },
        "calibration_change": {"max_fraction": float(change.max()), "median_fraction": float(np.median(change))},
        "sentence": _sentence(effect, report),
        "evidence": {
            "score_sigma": float(finding.score.z),
            "trials": float(finding.score.trials),
            "confirm": effect.cause.confirm,
            "target": effect.target.label,
            "sigma_of_size_under_this_law": effect.sigma,
            "is_converged": report.last.is_converged,
            "correlations": dict(finding.indistinguishable),
            "note": _note(effect),
        },
    }


def _note(effect: Effect) -> str:
    if effect.cause.identifier in ("zenith_weighting", "pattern_width", "dipole_azimuth", "point_source"):
        return "acts by ratio: P_sky times own(with)/own(without), from the package's own sky and antenna model"
    return ""


def _where(effect: Effect, report: StationReport) -> dict[str, Any]:
    data = report.data
    conditions = data.conditions
    members = effect.target.is_member
    parameters = effect.law.parameters
    frequency = conditions.frequency_mhz
    line = parameters.get("frequency_mhz")
    begin, end = float(conditions.time_unix.min()), float(conditions.time_unix.max())
    begin = parameters.get("date_unix", begin)
    hours = parameters.get("utc_h", [0, 24])
    return {
        "station": data.station,
        "frequency_mhz": [float(frequency[0]), float(frequency[-1])] if line is None else [line - 0.5, line + 0.5],
        "lst_h": [0.0, 24.0],
        "utc_h": [float(hours[0]), float(hours[1])],
        "dates": [_date(begin), _date(end)],
        "antennas": sorted({int(a) for a in data.antenna[members]}),
        "dipoles": sorted({str(d) for d in data.dipole[members]}),
    }


def _sentence(effect: Effect, report: StationReport) -> str:
    whom = f"station {report.data.station}"
    if effect.target.scope != "station":
        whom += f", {effect.target.label}"
    size = f"{effect.size:.3g} +- {effect.uncertainty:.2g} ({effect.cause.unit})"
    return f"In {whom}, {effect.cause.meaning}: {size}{_with(effect.law.parameters)}."


def _with(parameters: Mapping[str, Any]) -> str:
    words = "; ".join(f"{key} {value}" for key, value in _plain(parameters).items() if key != "date_unix")
    return f" with {words}" if words else ""


def _static_finding(score: StaticScore, report: StationReport) -> dict[str, Any]:
    data = report.data
    members = score.target.is_member
    change = np.abs(0.5 * score.size * (score.departure - score.departure.mean()))
    frequency = data.conditions.frequency_mhz
    return {
        "cause": score.cause.identifier,
        "indistinguishable": [name for name, _ in score.similar],
        "size": {"value": score.size, "sigma": score.sigma, "unit": score.cause.unit},
        "parameters": _plain(score.parameters),
        "significance_sigma": sigma_of(score.p_value),
        "p_value": score.p_value,
        "where": {
            "station": data.station,
            "frequency_mhz": [float(frequency[0]), float(frequency[-1])],
            "lst_h": [0.0, 24.0],
            "utc_h": [0.0, 24.0],
            "dates": [_date(float(data.conditions.time_unix.min())), _date(float(data.conditions.time_unix.max()))],
            "antennas": sorted({int(a) for a in data.antenna[members]}),
            "dipoles": sorted({str(d) for d in data.dipole[members]}),
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
        "sentence": f"In station {data.station}, {score.target.label}, {score.cause.meaning}: "
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


def _unexplained(leftover: Leftover, report: StationReport) -> dict[str, Any]:
    data = report.data
    frequency = data.conditions.frequency_mhz
    strong = frequency[leftover.channel_share > 0.5 * leftover.channel_share.max()]
    return {
        "p_value": leftover.p_value,
        "where": {
            "station": data.station,
            "axis": leftover.axis,
            "target": leftover.target,
            "frequency_mhz": [float(strong.min()), float(strong.max())],
            "dates": [_date(float(data.conditions.time_unix.min())), _date(float(data.conditions.time_unix.max()))],
        },
        "description": f"structure along {leftover.axis} in {leftover.target} of {data.station} that no cause of the "
        f"catalogue explains, strongest at {strong.min():.0f}-{strong.max():.0f} MHz",
        "gain": {
            "chi2": leftover.gain,
            "terms": leftover.dof,
            "held_out_log_likelihood_gain": leftover.held_out_gain,
        },
        "similar_to": [_finding(finding, report) for finding in report.similar],
    }


def _date(time_unix: float) -> str:
    return f"{datetime.fromtimestamp(time_unix, UTC):%Y-%m-%dT%H:%M:%SZ}"


def _plain(parameters: Any) -> dict[str, Any]:
    return {key: value.item() if isinstance(value, np.generic) else value for key, value in parameters.items()}
