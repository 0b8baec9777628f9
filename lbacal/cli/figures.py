"""The figures of reports: each takes core values and returns a matplotlib figure, drawn without a display."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.cli.figure_style import COLOURS
from lbacal_core.calibration.residuals import noise_at_input
from lbacal_core.curves import CalibrationCurve
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.lstcurve.compare import Comparison, in_db
from lbacal_core.skypower.table import SkyPower

DIPOLE_COLOURS = {"X": COLOURS[1], "Y": COLOURS[2]}
GREY = "#666666"
FULL_DAY = np.linspace(0.0, 24.0, 289)


def draw_lst_comparison(comparison: Comparison, simulated: dict[str, Floats]) -> Figure:
    """Measured LST curve, the simulation with and without noise, and what is left.

    Parameters
    ----------
    simulated
        Relative sky power of the band on `FULL_DAY`, for each polarisation.
    """
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    axes: Any = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[2, 1])
    curve = comparison.curve
    for column, dipole in enumerate(DIPOLES):
        colour, top, below = DIPOLE_COLOURS[dipole], axes[0, column], axes[1, column]
        points = {"fmt": "o", "ms": 3.5, "lw": 0.8, "color": colour}
        top.errorbar(curve.lst_hours, curve.variation_db[dipole], curve.error_db, label=f"measured, {dipole}", **points)
        for has_noise, style in ((False, "--"), (True, "-")):
            fit = comparison.of(dipole, has_noise=has_noise)
            words = f"sky and {100 * fit.noise_share:.0f} % noise" if has_noise else "sky alone"
            level = in_db(simulated[dipole], fit.noise_share) + fit.offset_db
            label = f"{words}: chi² per point {fit.chi2 / fit.points:.1f}"
            top.plot(FULL_DAY, level, style, color="black" if has_noise else GREY, lw=1.3, label=label)
        below.errorbar(
            curve.lst_hours,
            comparison.of(dipole, has_noise=True).residual_db,
            curve.error_db,
            label="with noise",
            **points,
        )
        below.plot(
            curve.lst_hours,
            comparison.of(dipole, has_noise=False).residual_db,
            "x",
            ms=4,
            color=GREY,
            label="sky alone",
        )
    label_lst_panels(axes)
    low, high = comparison.band_mhz
    figure.suptitle(f"Band of {low:g}-{high:g} MHz: only noise share and offset fitted", fontsize=11)
    return figure


def label_lst_panels(axes: Any) -> None:
    """Label an upper row of band power and a lower row of what is left of it, both over local sidereal time."""
    for top, below in axes.T:
        below.axhline(0.0, color="black", lw=0.8)
        top.legend(fontsize=7.5, frameon=False)
        below.legend(fontsize=7.5, frameon=False, ncols=2)
        below.set_xlabel("local sidereal time (h)")
    axes[0, 0].set_ylabel("band power, relative to LST 0 (dB)")
    axes[1, 0].set_ylabel("measured - simulated (dB)")
    axes[0, 0].set_xlim(0, 24)
    axes[0, 0].set_xticks(range(0, 25, 4))


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
        top.legend(fontsize=8, frameon=False)
        below.legend(fontsize=8, frameon=False)
        below.set_xlabel("frequency (MHz)")
    axes[0, 0].set_ylabel("C (µV per ADC unit)")
    axes[1, 0].set_ylabel("error of the fit (%)")
    return figure


def draw_noise(curve: CalibrationCurve, instrument: Instrument, sky_power: SkyPower) -> Figure:
    """Sky and noise terms referred to the start of the chain, fitted and published.

    The published terms are brought to our unit by one factor, the ratio of the two sky powers (geometric mean).
    """
    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    axes = figure.subplots()
    frequency, terms = instrument.frequency_mhz, read_table("noise_terms")
    sky = sky_power.power[curve.dipole or DIPOLES[0]].mean(axis=0)
    published_sky = np.interp(frequency, terms["mhz"], terms["sky"])
    factor = float(np.exp(np.log(sky / published_sky).mean()))
    ours = {"sky": sky, **noise_at_input(curve, instrument)}
    words = {"sky": "sky", "lna": "N_LNA", "rcu": "N_RCU", "adc": "N_ADC"}
    colours = dict(zip(words, COLOURS, strict=False))
    for name, label in words.items():
        axes.plot(frequency, ours[name], color=colours[name], lw=1.6, label=f"{label}, this fit")
        axes.plot(terms["mhz"], factor * terms[name], "--", color=colours[name], lw=1.0, label=f"{label}, published")
    axes.set_yscale("log")
    axes.set_xlabel("frequency (MHz)")
    axes.set_ylabel("power at the start of the chain (W m$^{-2}$ MHz$^{-1}$)")
    axes.set_title(f"{curve.name}", fontsize=11)
    axes.legend(fontsize=8, frameon=False, ncols=4)
    return figure


def draw_residuals(maps: dict[str, Floats], frequency_mhz: Floats) -> Figure:
    """Measured over predicted power minus 1, LST against frequency, one panel for each polarisation."""
    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    axes: Any = figure.subplots(1, len(maps), sharey=True)
    limit = 100 * float(np.nanpercentile(np.abs(np.stack(list(maps.values()))), 99))
    extent = (frequency_mhz[0] - 0.5, frequency_mhz[-1] + 0.5, 0.0, 24.0)
    image = None
    for panel, (dipole, values) in zip(np.atleast_1d(axes), maps.items(), strict=True):
        image = panel.imshow(
            100 * values, origin="lower", aspect="auto", extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit
        )
        panel.set_xlabel("frequency (MHz)")
        panel.set_title(f"dipole {dipole}", fontsize=11)
    np.atleast_1d(axes)[0].set_ylabel("local sidereal time (h)")
    if image is not None:
        figure.colorbar(image, ax=axes, label="measured / predicted - 1 (%), mean over antennas")
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
    axes.fill_between(
        month(band),
        values(band, "low"),
        values(band, "high"),
        color=GREY,
        alpha=0.25,
        lw=0,
        label=label + "middle 68 %",
    )
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
