"""The HTML report of an investigation: one file with its figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal.pages.report import embed, fill_report
from lbacal_core.audit.record import RecordError
from lbacal_core.causes.axes import AXES, Axis, axis_named
from lbacal_core.causes.cause import signature
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.findings import Finding
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.left_open import FoundValue
from lbacal_core.discovery.report import parameter_words
from lbacal_core.discovery.residual_structure import ResidualStructure
from lbacal_core.discovery.scan import Score
from lbacal_core.discovery.search import StationReport
from lbacal_core.grids import Floats

# The figures of an investigation: residuals before and after, signatures beside what they explain, scores.

BINS = 24
MAP_BINS, MAP_CHANNELS = 16, 3
"""Cells of a map: few enough that a weak effect rises above the noise of a cell."""
SHAPES = 6
WEAKEST_AXIS = 0.2
"""Share of the variance of a signature along its strongest axis, below which another axis is not shown."""
RED = "#b3322b"
POINTS: dict[str, Any] = {"fmt": "o", "ms": 3, "lw": 0.9, "color": "#444"}


def draw_scores(report: StationReport, on: Any = None) -> Figure:
    """The best score of every cause, with the probability that chance gives it; on axes if they are given."""
    scores: list[Score | AntennaScore] = [*report.scores, *report.antenna_scores]
    scores.reverse()
    axes: Any = on or Figure(figsize=(9.5, 0.27 * len(scores) + 1.2), layout="constrained").subplots()
    colours = [RED if score.p_value < report.alpha_of(score) else "#8a94a6" for score in scores]
    rows = range(len(scores))  # a cause that is scored for each cable name has several
    axes.barh(rows, [abs(score.z) for score in scores], color=colours)
    axes.set_yticks(rows, [score.cause.identifier for score in scores])
    axes.set_ylim(-0.7, len(scores) - 0.3)
    for k, score in zip(rows, scores, strict=True):
        axes.text(abs(score.z), k, f"  {score.target.label}, p = {score.p_value:.2g}", va="center", fontsize=7)
    axes.set(
        xlabel="best score over all its templates and targets (standard deviations)",
        xlim=(0, 1.35 * max(*(abs(score.z) for score in scores), 4.0)),
    )
    axes.tick_params(axis="y", labelsize=8)
    figure: Figure = axes.figure
    return figure


def draw_residual_maps(report: StationReport, target: Target | None, axes: Sequence[Axis]) -> Figure:
    """Residuals of the target's paths before and after, along axes, against frequency."""
    values_of = dict(pair for axis in axes if (pair := _values_on(report, axis)) is not None)
    figure = Figure(figsize=(9.5, 2.9 * len(values_of) + 0.3), layout="constrained")
    panels: Any = figure.subplots(len(values_of), 2, squeeze=False, sharex=True, sharey="row")
    stages = [_shown(stage.baseline.residual, report, target) for stage in (report.first, report.last)]
    frequency = report.station.conditions.frequency_mhz
    for row, (label, values) in zip(panels, values_of.items(), strict=True):
        maps = [_map(values, stage) for stage in stages]
        limit = 100 * float(np.nanpercentile(np.abs(np.stack(maps)), 99))
        extent = (frequency[0] - 0.5, frequency[-1] + 0.5, values.min(), values.max())
        for panel, shown, title in zip(row, maps, ("before", "after"), strict=True):
            image = panel.imshow(
                100 * shown, origin="lower", aspect="auto", extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit
            )
            panel.set_title(f"{title}: {100 * np.sqrt(np.nanmean(shown**2)):.2f} % rms", fontsize=10)
        row[0].set_ylabel(label)
        figure.colorbar(image, ax=row.tolist(), label="measured / model - 1 (%)")
    for panel in panels[-1]:
        panel.set_xlabel("frequency (MHz)")
    return figure


def draw_value(report: StationReport, value: FoundValue, on: Any = None) -> Figure:
    """What was found in a station: a cause along time or sidereal time, an antenna against the others, a wrong record.

    What matters most of it is drawn on axes, if they are given.
    """
    if on is None:
        figure = Figure(figsize=(9.5, 3.4), layout="constrained")
        panels: Any = figure.subplots(1, 1 + isinstance(value, Finding), squeeze=False)[0]
    else:
        figure, panels = on.figure, [on]
    if isinstance(value, Finding):
        _draw_profiles(report, value, panels)
    elif isinstance(value, RecordError):
        _draw_record(panels[0], report)
    else:
        _draw_antenna(panels[0], value, report.station.conditions.frequency_mhz)
    return figure


def _draw_profiles(report: StationReport, finding: Finding, panels: Any) -> None:
    """A signature at its size beside the residual that it explains, along its main axis and, on two axes, in frequency.

    The signature is close to one profile of the events times one of the channels: each panel shows the residual
    projected on the other profile.
    """
    conditions, one = report.station.conditions, finding.hypothesis
    expected, axis = _expected(report, finding), axes_of(report, finding)[0]
    observed = _shown(report.first.baseline.residual, report, one.target)
    events, channels = expected.shape
    expected, observed = expected - expected.mean(axis=0), observed - observed.mean(axis=0)
    of_event, _, of_channel = np.linalg.svd(expected, full_matrices=False)
    along, across = of_channel[0] / np.sqrt(channels), of_event[:, 0] / np.sqrt(events)
    sign = 1.0 if along.sum() >= 0 else -1.0
    along, across = sign * along, sign * across
    label, values = _values_on(report, axis) or ("", np.zeros(events))
    mean, error = _bins(values, observed @ along)
    panels[0].errorbar(_centres(values), 100 * mean, 100 * error, label="residual before", **POINTS)
    panels[0].plot(_centres(values), 100 * _bins(values, expected @ along)[0], color=RED, label=one.cause.identifier)
    panels[0].set(xlabel=label, ylabel="relative power, mean over channels (%)")
    for panel in panels:
        panel.axhline(0, color="#bbb", lw=0.8)
    panels[0].legend(fontsize=8, frameon=False)
    if len(panels) == 1:
        return
    frequency = conditions.frequency_mhz
    scatter = 100 * np.std(observed - expected, axis=0) / np.sqrt(events)
    panels[1].errorbar(frequency, 100 * across @ observed, scatter, **POINTS)
    panels[1].plot(frequency, 100 * across @ expected, color=RED)
    panels[1].set(xlabel="frequency (MHz)", ylabel="relative power along that profile (%)")


def _draw_record(axes: Any, report: StationReport) -> None:
    """The mean residual of all paths and channels along sidereal time, by the record as it was and put right."""
    for model, label, colour in ((report.as_recorded, "as recorded", RED), (report.first, "put right", "#2b6cb0")):
        if model is not None:
            lst = model.station.conditions.lst_hours
            mean, error = _bins(lst, model.baseline.residual.mean(axis=(0, 2)))
            axes.errorbar(_centres(lst), 100 * mean, 100 * error, **{**POINTS, "color": colour}, label=label)
    axes.axhline(0.0, lw=0.8, color="#888")
    axes.set(xlabel="local sidereal time (h)", ylabel="power beside the fitted chain (%)")
    axes.legend()


def _draw_antenna(axes: Any, score: AntennaScore, frequency_mhz: Floats) -> None:
    """An antenna or a cable name against the others along frequency, and the shape that was found."""
    level = np.nanmean(score.observed)
    others = "other cables" if score.target.scope == "cable" else "the others of its cable"
    label = f"{score.target.label} less {others}"
    axes.errorbar(frequency_mhz, 100 * (score.observed - level), 100 * score.error, label=label, **POINTS)
    fine = np.linspace(frequency_mhz[0], frequency_mhz[-1], 10 * frequency_mhz.size)
    shape = score.size * (score.departure - score.departure.mean())
    axes.plot(fine, 100 * CubicSpline(frequency_mhz, shape)(fine), color=RED, label=score.cause.identifier)
    axes.axhline(0, color="#bbb", lw=0.8)
    axes.set(xlabel="frequency (MHz)", ylabel="gain in front of the receiver (%)")
    axes.legend(fontsize=8, frameon=False)


def draw_structure(report: StationReport, structure: ResidualStructure) -> Figure:
    """Structure that no cause explains: what is left after everything, along its axis and in frequency.

    Where all paths show it together, a third panel has the amount in each of them.
    """
    labels = np.array([f"antenna {a} {d}" for a, d in zip(report.station.antenna, report.station.dipole, strict=True)])
    target = None if structure.target == "station" else Target("path", structure.target, labels == structure.target)
    left = _shown(report.last.baseline.residual, report, target)
    label, values = _values_on(report, structure.axis) or ("", np.zeros(len(left)))
    phase = (values - values.min()) / max(float(np.ptp(values)), 1e-9)
    shapes = np.cos(np.pi * np.outer(phase, np.arange(SHAPES + 1)))
    smooth = shapes[:, 1:] @ np.linalg.lstsq(shapes, left, rcond=None)[0][1:]
    of_channel = np.linalg.svd(smooth, full_matrices=False)[2][0]
    along = of_channel / np.sqrt(of_channel.size) * (1.0 if of_channel[0] >= 0 else -1.0)
    count = 3 if structure.amounts else 2
    figure = Figure(figsize=(4.75 * count, 3.4), layout="constrained")
    panels: Any = figure.subplots(1, count)
    mean, error = _bins(values, left @ along)
    panels[0].errorbar(_centres(values), 100 * mean, 100 * error, label="residual structure", **POINTS)
    order = np.argsort(values)
    panels[0].plot(values[order], 100 * (smooth @ along)[order], color=RED, lw=1, label="smooth along the axis")
    panels[0].set(xlabel=label, ylabel="relative power, in its channels (%)")
    panels[0].legend(fontsize=8, frameon=False)
    panels[1].plot(report.station.conditions.frequency_mhz, along * along.size, color=RED)
    panels[1].set(xlabel="frequency (MHz)", ylabel="spectrum (rms 1)")
    if structure.amounts:
        # A path that died early is compared with the others and has no amount.
        amounts = np.array([structure.amounts.get(label, (np.nan, np.nan)) for label in labels])
        for dipole in np.unique(report.station.dipole):
            own = report.station.dipole == dipole
            drawn = {"fmt": "o", "ms": 4, "lw": 1, "label": str(dipole)}
            panels[2].errorbar(report.station.antenna[own], amounts[own, 0], amounts[own, 1], **drawn)
        panels[2].set(xlabel="antenna", ylabel=f"amount, of that in {structure.target}")
        panels[2].legend(fontsize=8, frameon=False)
    for panel in panels:
        panel.axhline(0, color="#bbb", lw=0.8)
    return figure


def axes_of(report: StationReport, finding: Finding) -> list[Axis]:
    """Axes along which the template varies in these data, the strongest first."""
    expected = _expected(report, finding)
    variation: list[tuple[float, Axis]] = []
    for axis in (axis for axis in AXES if axis.name == axis.along):
        shown = _values_on(report, axis)
        if shown is not None:
            count = np.histogram(shown[1], MAP_BINS)[0] / shown[1].size
            means = np.nan_to_num(_map(shown[1], expected - expected.mean(axis=0)))
            variation.append((float(np.sum(count[:, None] * means**2)), axis))
    variation.sort(key=lambda pair: -pair[0])
    return [axis for strength, axis in variation if strength > WEAKEST_AXIS * variation[0][0]]


def _expected(report: StationReport, finding: Finding) -> Floats:
    """The finding's signature at its size as `_shown` would show it, shape (event, freq)."""
    station, one = report.station, finding.hypothesis
    change = one.size * signature(one.cause, report.last.baseline.terms, station.conditions, one.template)
    whole = change[station.class_of] * one.target.is_member[:, None, None] * station.is_present[:, :, None]
    return _shown(whole, report, one.target)


def _map(values: Floats, residual: Floats) -> Floats:
    """Mean in bins of an axis and in groups of channels, shape (bin, group)."""
    groups = np.array_split(np.arange(residual.shape[1]), max(residual.shape[1] // MAP_CHANNELS, 1))
    return np.stack([_bins(values, residual[:, group].mean(axis=1), MAP_BINS)[0] for group in groups], axis=1)


def draw_calibration_change(report: StationReport, finding: Finding) -> Figure:
    """Change of C(nu) of the target's paths by the fitted model."""
    change = 100 * finding.calibration_change
    frequency = report.station.conditions.frequency_mhz
    figure = Figure(figsize=(9.5, 2.8), layout="constrained")
    axes: Any = figure.subplots()
    low, middle, high = np.percentile(change, [16, 50, 84], axis=0)
    axes.fill_between(frequency, low, high, color=RED, alpha=0.25, lw=0, label="68 % of the target's paths")
    axes.plot(frequency, middle, color=RED, label="median")
    axes.axhline(0, color="#bbb", lw=0.8)
    axes.set(xlabel="frequency (MHz)", ylabel="change of C (%)")
    axes.legend(fontsize=8, frameon=False)
    return figure


def _values_on(report: StationReport, axis: Axis | None) -> tuple[str, Floats] | None:
    """Label of an axis and its value at every event, all alike where it is not known; None where data lack it."""
    if axis is None:
        return "event, in order of time", np.arange(report.station.event_id.size, dtype=float)
    values = axis.values(report.station.conditions)
    return None if values is None else (axis.label, np.nan_to_num(values, nan=float(np.nanmean(values))))


def _shown(residual: Floats, report: StationReport, target: Target | None) -> Floats:
    """What a finding is judged by: its paths less the others, or the station less each event's gain; (event, freq).

    That gain is common to all paths and channels and fluctuates by some percent, far more than most effects.
    """
    present = report.station.is_present
    everywhere = np.ones(len(present), dtype=bool)
    is_member = everywhere if target is None else target.is_member

    def mean(rows: NDArray[np.bool_]) -> Floats:
        count = np.maximum(present[rows].sum(axis=0), 1)
        return np.asarray(residual[rows].sum(axis=0) / count[:, None])

    if not np.all(is_member):
        return np.asarray(mean(is_member) - mean(~is_member))
    whole = mean(everywhere)
    return np.asarray(whole - whole.mean(axis=1, keepdims=True))


def _bins(values: Floats, quantity: Floats, bins: int = BINS) -> tuple[Floats, Floats]:
    """Mean and its standard error in equal bins of an axis; NaN where there is no event."""
    edges = np.linspace(values.min(), values.max() + 1e-9, bins + 1)
    place = np.clip(np.digitize(values, edges) - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins).astype(float)
    count[count == 0] = np.nan
    mean = np.bincount(place, weights=quantity, minlength=bins) / count
    square = np.bincount(place, weights=quantity**2, minlength=bins) / count
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0) / count)


def _centres(values: Floats) -> Floats:
    edges = np.linspace(values.min(), values.max() + 1e-9, BINS + 1)
    return np.asarray((edges[1:] + edges[:-1]) / 2)


def draw_page(content: dict[str, Any], reports: Sequence[StationReport]) -> str:
    """The report of `lbacal_core.discovery.report.investigate` as a page."""
    return fill_report("investigation.html", report=content, stations=[_station(report) for report in reports])


def _station(report: StationReport) -> dict[str, Any]:
    shown = [*report.findings, *report.similar]
    structure = report.structure
    return {
        "name": report.station.name,
        "paths": len(report.station.antenna),
        "events": len(report.station.event_id),
        "findings": [_finding(report, finding, is_named=finding in report.findings) for finding in shown],
        "record": [{"sentence": one.sentence, "figure": embed(draw_value(report, one))} for one in report.record],
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
        "figure": embed(draw_value(report, finding)),
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
        "figure": embed(draw_value(report, score)),
        "size": f"{score.size:.4g} ± {score.sigma:.2g} {score.cause.unit}",
        "parameters": ", ".join(parameter_words(score.parameters)) or "none",
        "note": score.cause.note(score.parameters, score.size),
        "indistinguishable": ", ".join(f"{name} (r = {r:.2f})" for name, r in score.similar) or "nothing",
        "confirm": score.cause.confirm,
        "change": f"its own C contains it; the C of the station is up to {change.max():.2g} % off for this antenna",
    }
