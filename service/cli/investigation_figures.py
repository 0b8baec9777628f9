"""The figures of an investigation: residuals before and after, signatures beside what they explain, scores."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lbacal_core.causes.terms import signature
from lbacal_core.discovery.extend import Extension
from lbacal_core.discovery.investigate import Finding, StationReport
from lbacal_core.discovery.targets import Target
from lbacal_core.grids import Floats

BINS = 24
ALARM_P = 0.0025


def draw_scores(report: StationReport) -> Figure:
    """The best score of every cause in the first scan, with the probability that chance gives it."""
    scores = report.first_scan[::-1]
    figure = Figure(figsize=(9.5, 0.27 * len(scores) + 1.2), layout="constrained")
    axes: Any = figure.subplots()
    colours = ["#b3322b" if score.p_value < ALARM_P else "#8a94a6" for score in scores]
    axes.barh([score.cause.identifier for score in scores], [abs(score.z) for score in scores], color=colours)
    for k, score in enumerate(scores):
        axes.text(abs(score.z), k, f"  {score.target.label}, p = {score.p_value:.2g}", va="center", fontsize=7)
    axes.set_xlabel("best score over all its laws and targets (standard deviations)")
    axes.set_xlim(0, 1.35 * max(*(abs(score.z) for score in scores), 4.0))
    axes.tick_params(axis="y", labelsize=8)
    return figure


def draw_residual_maps(report: StationReport, target: Target | None) -> Figure:
    """Residuals before and after along LST, UTC and date, against frequency, mean over the paths concerned."""
    axes_of = _axes(report)
    figure = Figure(figsize=(9.5, 3.0 * len(axes_of)), layout="constrained")
    panels: Any = figure.subplots(len(axes_of), 2, squeeze=False, sharex=True)
    is_member = np.ones(len(report.data.antenna), dtype=bool) if target is None else target.is_member
    frequency = report.data.conditions.frequency_mhz
    for row, (label, values) in zip(panels, axes_of.items(), strict=True):
        maps = [_binned(stage, values, is_member) for stage in (report.first, report.last)]
        limit = 100 * float(np.nanpercentile(np.abs(np.stack(maps)), 99))
        extent = (frequency[0] - 0.5, frequency[-1] + 0.5, values.min(), values.max())
        for panel, shown, title in zip(row, maps, ("before", "after"), strict=True):
            image = panel.imshow(
                100 * shown, origin="lower", aspect="auto", extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit
            )
            panel.set_title(title, fontsize=10)
        row[0].set_ylabel(label)
        figure.colorbar(image, ax=row.tolist(), label="measured / model - 1 (%)")
    for panel in panels[-1]:
        panel.set_xlabel("frequency (MHz)")
    return figure


def draw_finding(report: StationReport, finding: Finding) -> Figure:
    """The finding's signature at its size beside the residual of the baseline, along the axis where it acts most."""
    data, effect = report.data, finding.effect
    members = effect.target.is_member
    shape = effect.size * signature(effect.cause, report.last.baseline.terms, data.conditions, effect.law)
    expected = np.mean(shape[data.class_of[members]], axis=0)
    observed = _mean(report.first, members)
    figure = Figure(figsize=(9.5, 3.4), layout="constrained")
    panels: Any = figure.subplots(1, 2)
    label, values = max(_axes(report).items(), key=lambda item: float(np.var(_bins(item[1], expected.mean(axis=1))[0])))
    centres = _centres(values)
    mean, error = _bins(values, observed.mean(axis=1) - observed.mean())
    shown, _ = _bins(values, expected.mean(axis=1) - expected.mean())
    panels[0].errorbar(centres, 100 * mean, 100 * error, fmt="o", ms=3, color="#444", label="residual before")
    panels[0].plot(centres, 100 * shown, color="#b3322b", label=effect.cause.identifier)
    panels[0].set_xlabel(label)
    weight = expected.mean(axis=1) - expected.mean()
    weight = weight / max(float(weight @ weight), 1e-300)
    frequency = data.conditions.frequency_mhz
    panels[1].plot(frequency, 100 * (weight @ observed) * weight.std() ** -1 / weight.size, "o", ms=3, color="#444")
    panels[1].plot(frequency, 100 * (weight @ expected) * weight.std() ** -1 / weight.size, color="#b3322b")
    panels[1].set_xlabel("frequency (MHz)")
    for panel in panels:
        panel.set_ylabel("relative power (%)")
        panel.axhline(0, color="#bbb", lw=0.8)
    panels[0].legend(fontsize=8, frameon=False)
    return figure


def draw_calibration_change(report: StationReport, finding: Finding) -> Figure:
    """What the extended model does to C(nu) of the paths concerned."""
    change = 100 * finding.calibration_change
    frequency = report.data.conditions.frequency_mhz
    figure = Figure(figsize=(9.5, 2.8), layout="constrained")
    axes: Any = figure.subplots()
    low, middle, high = np.percentile(change, [16, 50, 84], axis=0)
    axes.fill_between(frequency, low, high, color="#b3322b", alpha=0.25, lw=0, label="68 % of the paths concerned")
    axes.plot(frequency, middle, color="#b3322b", label="median")
    axes.axhline(0, color="#bbb", lw=0.8)
    axes.set_xlabel("frequency (MHz)")
    axes.set_ylabel("change of C (%)")
    axes.legend(fontsize=8, frameon=False)
    return figure


def _axes(report: StationReport) -> dict[str, Floats]:
    conditions = report.data.conditions
    days = (conditions.time_unix - conditions.time_unix.min()) / 86_400.0
    return {
        "local sidereal time (h)": conditions.lst_hours,
        "UTC (h)": conditions.utc_hours,
        "days since the first event": days,
    }


def _mean(stage: Extension, is_member: NDArray[np.bool_]) -> Floats:
    residual = stage.baseline.residual[is_member]
    count = np.maximum((residual[:, :, 0] != 0).sum(axis=0), 1)
    return np.asarray(residual.sum(axis=0) / count[:, None])


def _binned(stage: Extension, values: Floats, is_member: NDArray[np.bool_]) -> Floats:
    residual = _mean(stage, is_member)
    return np.stack([_bins(values, channel)[0] for channel in residual.T], axis=1)


def _bins(values: Floats, quantity: Floats) -> tuple[Floats, Floats]:
    """Mean and its standard error in equal bins of an axis; NaN where there is no event."""
    edges = np.linspace(values.min(), values.max() + 1e-9, BINS + 1)
    place = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS).astype(float)
    count[count == 0] = np.nan
    mean = np.bincount(place, weights=quantity, minlength=BINS) / count
    square = np.bincount(place, weights=quantity**2, minlength=BINS) / count
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0) / count)


def _centres(values: Floats) -> Floats:
    edges = np.linspace(values.min(), values.max() + 1e-9, BINS + 1)
    return np.asarray((edges[1:] + edges[:-1]) / 2)
