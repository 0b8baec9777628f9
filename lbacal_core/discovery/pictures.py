"""The picture of a finding as numbers: what a report carries, so that whoever reads it can draw what was found.

Residuals are relative powers, shown as a finding is judged: those of its paths less the others of the station, or of
the whole station less each event's gain, which is common to all paths and channels and fluctuates by some percent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal_core.audit.record import EXCHANGE, RecordError
from lbacal_core.causes.axes import AXES, Axis, axis_named
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.findings import Finding
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.refit import power_ratio, with_noise
from lbacal_core.discovery.residual_structure import ResidualStructure
from lbacal_core.discovery.search import StationReport
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.linear import solve_symmetric

BINS = 24
MAP_BINS, MAP_CHANNELS = 16, 3
"""Cells of a map: few enough that a weak effect rises above the noise of a cell."""
SHAPES = 6
WEAKEST_AXIS = 0.2
"""Share of the variance of a signature along its strongest axis, below which another axis is not shown."""
FINE = 5
"""Points of a curve a channel, where it may turn between channels."""
MEAN_AXES = ("lst", "utc", "date")
DIGITS = 4
SMALLEST = 0.01
"""Floor of a power over that of its model, by which another is divided."""

Picture = dict[str, Any]


def picture_finding(report: StationReport, finding: Finding) -> Picture:
    """Its course and law, residual maps before and after, and the change of C."""
    one = finding.hypothesis
    change = np.percentile(finding.calibration_change, [16, 50, 84], axis=0)
    return {
        **picture_hypothesis(report, one),
        "maps": _picture_maps(report, one.target, _axes_of(report, one)),
        "change_of_c": dict(zip(("low", "median", "high"), map(_told, change), strict=True)),
    }


def picture_hypothesis(report: StationReport, one: Hypothesis) -> Picture:
    """Course along the main axis, and law along frequency; of a finding, or of a sentence that is not in the model.

    Both hold the measured power over the model without it, all else as fitted, beside what it makes of that model.
    Relative to the model of before, whose gain is that of the mean over the window, both would have other scales:
    points of a step of 15 % stood 0.7 % above the curve. What a hypothesis does is close to one profile of the events
    times one of the channels: each of the two is the projection on the other.
    """
    effect = _effect(report, one)
    is_fitted = any(known is one for known in report.last.hypotheses)
    present = report.station.is_present[:, :, None]
    over_model = ((1.0 + report.last.baseline.residual) * (1.0 + effect * is_fitted) - 1.0) * present
    expected, observed = (_shown(values, report, one.target) for values in (effect, over_model))
    expected, observed = expected - expected.mean(axis=0), observed - observed.mean(axis=0)
    events, channels = expected.shape
    of_event, _, of_channel = np.linalg.svd(expected, full_matrices=False)
    sign = 1.0 if of_channel[0].sum() >= 0 else -1.0
    along, across = sign * of_channel[0] / np.sqrt(channels), sign * of_event[:, 0] / np.sqrt(events)
    label, values = _values_on(report, _axes_of(report, one)[0]) or ("", np.zeros(events))
    return {
        "course": {
            "label": label, "at": _told(_centres(values)),
            **_told_points(*_bins(values, observed @ along), _bins(values, expected @ along)[0]),
        },
        "law": {
            "frequency_mhz": report.station.conditions.frequency_mhz.tolist(),
            **_told_points(across @ observed, np.std(observed - expected, axis=0) / np.sqrt(events), across @ expected),
        },
    }  # fmt: skip


def picture_antenna(report: StationReport, score: AntennaScore) -> Picture:
    """An antenna or a cable name against the others along frequency, and the shape that was found."""
    frequency = report.station.conditions.frequency_mhz
    fine = np.linspace(frequency[0], frequency[-1], FINE * (frequency.size - 1) + 1)
    shape = score.size * (score.departure - score.departure.mean())
    others = "other cables" if score.target.scope == "cable" else "the others of its cable"
    return {
        "against": {
            "label": f"{score.target.label} less {others}", "frequency_mhz": frequency.tolist(),
            **_told_points(score.observed - np.nanmean(score.observed), score.error, shape),
            "fine_mhz": _told(fine), "fine": _told(CubicSpline(frequency, shape)(fine)),
        },
    }  # fmt: skip


def picture_record(report: StationReport, error: RecordError) -> Picture:
    """The paths of the first letter along sidereal time as recorded, and what the error makes of their power."""
    before, after = report.as_recorded or report.first, report.first
    first, *others = before.station.conditions.dipoles
    truly = others[0] if error.line.kind == EXCHANGE else first
    right = {path: k for k, path in enumerate(_paths_of(after.station))}
    concerned = error.line.antennas if error.line.kind == EXCHANGE and error.line.antennas else before.station.antenna
    rows = [
        (k, right[antenna, truly], right.get((antenna, first), k))
        for k, (antenna, letter) in enumerate(_paths_of(before.station))
        if letter == first and antenna in concerned and (antenna, truly) in right
    ]
    of_record, of_right, same = np.array(rows, dtype=np.intp).reshape(-1, 3).T
    observed, without = before.baseline.residual[of_record], after.baseline.residual
    is_during = error.line.is_during(before.station.conditions.time_unix)[:, None]
    without = np.where(is_during, without[of_right], without[same])
    expected = (1.0 + observed) / np.maximum(1.0 + without, SMALLEST) - 1.0
    lst = before.station.conditions.lst_hours
    points = _bins(lst, observed.mean(axis=(0, 2)))
    label = f"{axis_named('lst').label} as recorded, letter {first}"
    told = _told_points(*points, _bins(lst, expected.mean(axis=(0, 2)))[0])
    return {"course": {"label": label, "at": _told(_centres(lst)), **told}}


def _paths_of(station: Station) -> list[tuple[int, str]]:
    return list(zip(station.antenna.tolist(), station.dipole.tolist(), strict=True))


def picture_station(report: StationReport) -> Picture:
    """Residual maps of the mean over all paths, and the structure that no cause explains where there is any."""
    mean = {"maps": _picture_maps(report, None, [axis_named(name) for name in MEAN_AXES])}
    return mean if report.structure is None else {**mean, "structure": _picture_structure(report, report.structure)}


def _picture_structure(report: StationReport, structure: ResidualStructure) -> Picture:
    """What is left after everything, along its axis and in frequency; the amount in each path where all show it."""
    labels = np.array([f"antenna {a} {d}" for a, d in zip(report.station.antenna, report.station.dipole, strict=True)])
    target = None if structure.target == "station" else Target("path", structure.target, labels == structure.target)
    left = _shown(report.last.baseline.residual, report, target)
    label, values = _values_on(report, structure.axis) or ("", np.zeros(len(left)))
    phase = (values - values.min()) / max(float(np.ptp(values)), 1e-9)
    shapes = np.cos(np.pi * np.outer(phase, np.arange(SHAPES + 1)))
    smooth = shapes[:, 1:] @ solve_symmetric(shapes.T @ shapes, shapes.T @ left)[1:]
    of_channel = np.linalg.svd(smooth, full_matrices=False)[2][0]
    along = of_channel / np.sqrt(of_channel.size) * (1.0 if of_channel[0] >= 0 else -1.0)
    amounts = structure.amounts or {}  # a path that died early is compared with the others and has none
    return {
        "course": {
            "label": label, "at": _told(_centres(values)),
            **_told_points(*_bins(values, left @ along), _bins(values, smooth @ along)[0]),
        },
        "spectrum": {
            "frequency_mhz": report.station.conditions.frequency_mhz.tolist(), "rms_1": _told(along * along.size)
        },
        "amounts": {
            "in": structure.target,
            "paths": [[int(a), str(d), *_told(amounts[label])] for a, d, label in zip(
                report.station.antenna, report.station.dipole, labels, strict=True) if label in amounts],
        },
    }  # fmt: skip


def _picture_maps(report: StationReport, target: Target | None, axes: Sequence[Axis]) -> list[Picture]:
    """Residuals of the target's paths before and after, along axes, against frequency."""
    frequency = report.station.conditions.frequency_mhz
    half = 0.5 * float(np.median(np.diff(frequency)))
    before, after = (_shown(stage.baseline.residual, report, target) for stage in (report.first, report.last))
    return [
        {
            "label": label, "from": float(values.min()), "to": float(values.max()),
            "frequency_mhz": [float(frequency[0]) - half, float(frequency[-1]) + half],
            "before": [_told(row) for row in _map(values, before)],
            "after": [_told(row) for row in _map(values, after)],
        }
        for axis in axes if (pair := _values_on(report, axis)) is not None for label, values in [pair]
    ]  # fmt: skip


def _told_points(observed: Floats, sigma: Floats, expected: Floats) -> Picture:
    return {"observed": _told(observed), "sigma": _told(sigma), "expected": _told(expected)}


def _told(values: Any) -> list[float | None]:
    """Numbers for JSON, with as many digits as a picture shows; None where unknown."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in values]


def _axes_of(report: StationReport, one: Hypothesis) -> list[Axis]:
    """Axes along which the template varies in these data, the strongest first."""
    expected = _shown(_effect(report, one), report, one.target)
    variation: list[tuple[float, Axis]] = []
    for axis in (axis for axis in AXES if axis.name == axis.along):
        shown = _values_on(report, axis)
        if shown is not None:
            count = np.histogram(shown[1], MAP_BINS)[0] / shown[1].size
            means = np.nan_to_num(_map(shown[1], expected - expected.mean(axis=0)))
            variation.append((float(np.sum(count[:, None] * means**2)), axis))
    variation.sort(key=lambda pair: -pair[0])
    return [axis for strength, axis in variation if strength > WEAKEST_AXIS * variation[0][0]]


def _effect(report: StationReport, one: Hypothesis) -> Floats:
    """Relative change of the power by a hypothesis beside all others, shape (path, event, freq); 0 where absent."""
    last = report.last
    terms = last.baseline.terms if last.noise is None else with_noise(report.station, last.baseline.terms, last.noise)
    others = [known for known in last.hypotheses if known is not one]
    ratio = power_ratio(report.station, terms, [*others, one]) / power_ratio(report.station, terms, others)
    return np.asarray((ratio - 1.0) * report.station.is_present[:, :, None])


def _map(values: Floats, residual: Floats) -> Floats:
    """Mean in bins of an axis and in groups of channels, shape (bin, group)."""
    groups = np.array_split(np.arange(residual.shape[1]), max(residual.shape[1] // MAP_CHANNELS, 1))
    return np.stack([_bins(values, residual[:, group].mean(axis=1), MAP_BINS)[0] for group in groups], axis=1)


def _values_on(report: StationReport, axis: Axis | None) -> tuple[str, Floats] | None:
    """Label of an axis and its value at every event, all alike where it is not known; None where data lack it."""
    if axis is None:
        return "event, in order of time", np.arange(report.station.event_id.size, dtype=float)
    values = axis.values(report.station.conditions)
    return None if values is None else (axis.label, np.nan_to_num(values, nan=float(np.nanmean(values))))


def _shown(residual: Floats, report: StationReport, target: Target | None) -> Floats:
    """The paths of the target less the others, or the whole station less each event's gain; shape (event, freq)."""
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
