"""The HTML report of an investigation: one file with its figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.cli.investigation_figures import (
    axes_of,
    draw_antenna,
    draw_calibration_change,
    draw_finding,
    draw_residual_maps,
    draw_scores,
    draw_structure,
)
from lbacal.cli.report_pages import embed, fill_report
from lbacal.files import written_beside
from lbacal_core.causes.axes import axis_named
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.findings import Finding
from lbacal_core.discovery.report import parameter_words
from lbacal_core.discovery.search import StationReport


def write_investigation_page(content: dict[str, Any], reports: Sequence[StationReport], path: Path) -> None:
    """Write the report of `lbacal_core.discovery.report.investigate` as a page."""
    stations = [_station(report) for report in reports]
    with written_beside(path) as beside:
        beside.write_text(fill_report("investigation.html", report=content, stations=stations), encoding="utf-8")


def _station(report: StationReport) -> dict[str, Any]:
    shown = [*report.findings, *report.similar]
    structure = report.structure
    return {
        "name": report.station.name,
        "paths": len(report.station.antenna),
        "events": len(report.station.event_id),
        "findings": [_finding(report, finding, is_named=finding in report.findings) for finding in shown],
        "antennas": [_antenna(report, score) for score in report.antennas],
        "structure": embed(draw_structure(report, structure)) if structure else None,
        "maps": embed(draw_residual_maps(report, None, [axis_named(name) for name in ("lst", "utc", "date")])),
        "scores": embed(draw_scores(report)),
    }


def _finding(report: StationReport, finding: Finding, *, is_named: bool) -> dict[str, Any]:
    one = finding.hypothesis
    axes = axes_of(report, finding)
    change = 100 * finding.calibration_change
    return {
        "cause": one.cause.identifier,
        "target": one.target.label,
        "is_named": is_named,
        "figure": embed(draw_finding(report, finding)),
        "maps": embed(draw_residual_maps(report, one.target, axes)),
        "calibration": embed(draw_calibration_change(report, finding)),
        "size": f"{one.size:.4g} ± {one.uncertainty:.2g} {one.cause.unit}",
        "parameters": ", ".join(parameter_words(one.template.parameters)) or "none",
        "chi2": f"{finding.chi2_before:.0f} before, {finding.chi2_after:.0f} after "
        f"({finding.chi2_before - finding.chi2_after:.0f} gained; {finding.dof} degrees of freedom)",
        "held_out": f"ln L + {finding.held_out_gain:.1f} on {report.station.event_id.size} events in four folds",
        "indistinguishable": ", ".join(f"{name} (r = {r:.2f})" for name, r in finding.indistinguishable) or "nothing",
        "confirm": one.cause.confirm,
        "change": f"{np.median(change):+.2f} % in the median, {change.flat[np.argmax(np.abs(change))]:+.2f} % at most",
    }


def _antenna(report: StationReport, score: AntennaScore) -> dict[str, Any]:
    change = 50 * np.abs(score.size * (score.departure - score.departure.mean()))
    return {
        "cause": score.cause.identifier,
        "target": score.target.label,
        "figure": embed(draw_antenna(score, report.station.conditions.frequency_mhz)),
        "size": f"{score.size:.4g} ± {score.sigma:.2g} {score.cause.unit}",
        "parameters": ", ".join(parameter_words(score.parameters)) or "none",
        "note": score.cause.note(score.parameters, score.size),
        "indistinguishable": ", ".join(f"{name} (r = {r:.2f})" for name, r in score.similar) or "nothing",
        "confirm": score.cause.confirm,
        "change": f"its own C contains it; the C of the station is up to {change.max():.2g} % off for this antenna",
    }
