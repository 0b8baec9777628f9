"""The HTML report of an investigation: one file with its figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.discovery.investigate import Finding, StationReport
from lbacal_core.discovery.statics import StaticScore
from service.cli.investigation_figures import (
    axes_of,
    draw_calibration_change,
    draw_finding,
    draw_leftover,
    draw_residual_maps,
    draw_scores,
    draw_static,
)
from service.cli.report_pages import embed, fill_report


def write_investigation_page(content: dict[str, Any], reports: Sequence[StationReport], path: Path) -> None:
    """Write the report of `lbacal_core.discovery.report.investigate` as a page."""
    stations = [_station(report) for report in reports]
    path.write_text(fill_report("investigation.html", report=content, stations=stations), encoding="utf-8")


def _station(report: StationReport) -> dict[str, Any]:
    shown = [*report.findings, *report.similar]
    leftover = report.leftover
    return {
        "name": report.data.station,
        "paths": len(report.data.antenna),
        "events": len(report.data.event_id),
        "findings": [_finding(report, finding, is_named=finding in report.findings) for finding in shown],
        "static": [_static(report, score) for score in report.static],
        "leftover": embed(draw_leftover(report, leftover)) if leftover else None,
        "maps": embed(draw_residual_maps(report, None, ["lst", "utc", "date"])),
        "scores": embed(draw_scores(report)),
    }


def _finding(report: StationReport, finding: Finding, *, is_named: bool) -> dict[str, Any]:
    effect = finding.effect
    axes = axes_of(report, finding)
    parameters = {key: value for key, value in effect.law.parameters.items() if not key.endswith("_unix")}
    change = 100 * finding.calibration_change
    return {
        "cause": effect.cause.identifier,
        "target": effect.target.label,
        "is_named": is_named,
        "figure": embed(draw_finding(report, finding)),
        "maps": embed(draw_residual_maps(report, effect.target, axes)),
        "calibration": embed(draw_calibration_change(report, finding)),
        "size": f"{effect.size:.4g} ± {effect.uncertainty:.2g} {effect.cause.unit}",
        "parameters": ", ".join(f"{key} {value}" for key, value in parameters.items()) or "none",
        "chi2": f"{finding.chi2_before:.0f} before, {finding.chi2_after:.0f} after "
        f"({finding.chi2_before - finding.chi2_after:.0f} gained; {finding.dof} degrees of freedom)",
        "held_out": f"ln L + {finding.held_out_gain:.1f} on {finding.held_out_events} events in four folds",
        "indistinguishable": ", ".join(f"{name} (r = {r:.2f})" for name, r in finding.indistinguishable) or "nothing",
        "confirm": effect.cause.confirm,
        "change": f"{np.median(change):+.2f} % in the median, {change.flat[np.argmax(np.abs(change))]:+.2f} % at most",
    }


def _static(report: StationReport, score: StaticScore) -> dict[str, Any]:
    change = 50 * np.abs(score.size * (score.departure - score.departure.mean()))
    return {
        "cause": score.cause.identifier,
        "target": score.target.label,
        "figure": embed(draw_static(score, report.data.conditions.frequency_mhz)),
        "size": f"{score.size:.4g} ± {score.sigma:.2g} {score.cause.unit}",
        "parameters": ", ".join(f"{key} {value:g}" for key, value in score.parameters.items()) or "none",
        "note": score.cause.note(score.parameters, score.size),
        "indistinguishable": ", ".join(f"{name} (r = {r:.2f})" for name, r in score.similar) or "nothing",
        "confirm": score.cause.confirm,
        "change": f"its own C contains it; the C of the station is up to {change.max():.2g} % off for this antenna",
    }
