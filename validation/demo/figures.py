"""Figures of the demo's page: C against what was planted, and C over time with its step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.report import DIPOLE_COLOURS, GREY
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats


def draw_calibration(
    stations: Sequence[CalibrationCurve], paths: Sequence[CalibrationCurve], truth: dict[str, Floats]
) -> Figure:
    """C(nu) of a station's two dipoles with the spread of its paths, beside the published curve and the planted one."""
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    axes: Any = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[2, 1])
    published = read_table("published_calibration")
    for column, station in enumerate(stations):
        if station.c is None or station.c_sigma_stat is None or station.dipole is None:
            continue
        top, below, colour = axes[0, column], axes[1, column], DIPOLE_COLOURS[station.dipole]
        frequency, planted = station.frequency_mhz, truth[station.dipole]
        of_paths = np.array([p.c for p in paths if p.c is not None and p.dipole == station.dipole])
        spread = np.nanpercentile(of_paths, [16, 84], axis=0)
        top.fill_between(frequency, *(1e6 * spread), color=GREY, alpha=0.25, lw=0, label="68 % of its paths")
        top.plot(frequency, 1e6 * station.c, color=colour, lw=1.5, label=f"{station.name}, fitted")
        top.plot(frequency, 1e6 * planted, ":", color="black", lw=1.5, label="planted in the simulation")
        top.plot(published["mhz"], 1e6 * published["c"], color=GREY, lw=1.0, label="published (Mulrey et al. 2019)")
        error = station.c_sigma_stat / planted
        ratio = station.c / planted - 1.0
        below.fill_between(frequency, 100 * (ratio - error), 100 * (ratio + error), color=colour, alpha=0.25, lw=0)
        below.plot(frequency, 100 * ratio, color=colour, lw=1.3, label="fitted / planted - 1, 1 standard deviation")
        below.axhline(0.0, color="black", lw=0.8)
        for panel in (top, below):
            panel.legend(fontsize=8, frameon=False)
        below.set_xlabel("frequency (MHz)")
    axes[0, 0].set_ylabel("C (µV per ADC unit)")
    axes[1, 0].set_ylabel("error of the fit (%)")
    return figure


def draw_drift(station: dict[str, Any], path: dict[str, Any]) -> Figure:
    """C of every month against the first year: a station's paths as a band, and one path with its step.

    Parameters
    ----------
    station, path
        Answers of ``GET /v1/drift``.
    """
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    axes: Any = figure.subplots()

    def month(points: list[dict[str, Any]]) -> Any:
        return np.array([point["month"] for point in points], dtype="datetime64[M]") + np.timedelta64(14, "D")

    def values(points: list[dict[str, Any]], name: str) -> Floats:
        return np.array([point[name] for point in points])

    band, one = station["months"], path["months"]
    label = f"{station['station']}, {band[0]['paths']} paths: "
    low, high = values(band, "low"), values(band, "high")
    axes.fill_between(month(band), low, high, color=GREY, alpha=0.25, lw=0, label=label + "middle 68 %")
    axes.plot(month(band), values(band, "c_ratio"), color=GREY, label=label + "median")
    c_ratio = values(one, "c_ratio")
    name = f"antenna {path['antenna']} {path['dipole']}"
    error = values(one, "high") - c_ratio
    axes.errorbar(month(one), c_ratio, error, fmt="o", ms=4, lw=1, color=DIPOLE_COLOURS[path["dipole"]], label=name)
    for step in path["steps"][:1]:
        when = np.datetime64(step["date"])
        text = f"step of {name}: {100 * step['size']:+.1f} ± {100 * step['sigma']:.1f} %, {step['date']}"
        axes.axvline(when, color="black", lw=0.9, ls="--", label=text)
    axes.set(xlabel="month (UTC)", ylabel="C / C of the first year")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    return figure
