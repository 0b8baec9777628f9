"""The HTML report of an LST curve: one file with its figures inside."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.report import DIPOLE_COLOURS, embed, fill_report, label_lst_panels
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.curve_search import CurveInvestigation
from lbacal_core.grids import Floats
from lbacal_core.sky.table import read_at

# The figures of an LST curve: what was measured, the simulation before and after, and what each hypothesis does.

COLOURS = DIPOLE_COLOURS | {"X - Y": "#2b8a5f"}
GREY = "#8a94a6"
SMOOTH_HOURS = np.linspace(0.0, 24.0, 193)
MOST_LINES = 5


def draw_curve(found: CurveInvestigation, title: str) -> Figure:
    """X, Y and their difference with both error bars, the simulation before and after, and what both leave."""
    figure = Figure(figsize=(11.5, 6.0), layout="constrained")
    axes: Any = figure.subplots(2, 3, sharex=True, height_ratios=[2, 1])
    curve, hours = found.fitter.curve, found.fitter.curve.lst_hours
    per_point = {id(fit): fit.chi2_drawn / fit.points for fit in (found.first, found.last)}
    for column, name in enumerate(COLOURS):
        top, below, colour = axes[0, column], axes[1, column], COLOURS[name]
        estimated, drawn = _errors(found, name)
        measured, bars = _combine(curve.variation_db, name), f"bars as drawn; estimated {estimated:.3f} dB"
        top.errorbar(hours, measured, drawn, fmt="none", ecolor=GREY, lw=0.6, label=bars)
        top.errorbar(hours, measured, estimated, fmt="o", ms=3, lw=1.3, color=colour, label=f"measured, {name}")
        for fit, style, words in ((found.first, "--", "before"), (found.last, "-", "after")):
            line = _smooth(_combine(fit.curve_db, name))
            label = f"simulation {words}: chi² per point {per_point[id(fit)]:.1f}" if column == 0 else None
            top.plot(SMOOTH_HOURS, line, style, color="black", lw=1.3, label=label)
        if found.fitter.has_model_spread:
            spread = _spread(found, name)
            middle = _smooth(_combine(found.last.curve_db, name))
            top.fill_between(
                SMOOTH_HOURS, middle - spread, middle + spread, color="black", alpha=0.1, lw=0,
                label="spread of sky and antenna models" if column == 0 else None,
            )  # fmt: skip
        below.plot(hours, _combine(found.first.residual_db, name), "x", ms=4, color=GREY, label="before")
        left = _combine(found.last.residual_db, name)
        below.errorbar(hours, left, estimated, fmt="o", ms=3, lw=1.1, color=colour, label="after")
        top.set_title(name if name in DIPOLES else "difference X - Y", fontsize=10)
    label_lst_panels(axes)
    low, high = found.band_mhz
    named = ", ".join(name_hypothesis(found.last)) or "nothing found"
    figure.suptitle(f"{title}, {low:g}-{high:g} MHz: {named}", fontsize=11)
    return figure


def draw_ranking(found: CurveInvestigation, on: Any = None) -> Figure:
    """Chi^2 of every cause by itself, and of the sets that the data cannot exclude; on axes if they are given."""
    shown = [*{fit.labels: fit for fit in (found.last, *found.open, *found.single) if fit.choices}.values()][::-1]
    are_open = {fit.labels for fit in found.open}
    axes: Any = on or Figure(figsize=(10.5, 0.27 * len(shown) + 1.4), layout="constrained").subplots()
    for row, fit in enumerate(shown):
        is_named, is_open = fit.labels == found.last.labels, fit.labels in are_open
        colour = COLOURS["X"] if is_named else "#d99a2b" if is_open else GREY
        axes.barh(row, fit.per_point["estimated"], color=colour)
        words = "  {estimated:.2f}  (drawn bars {drawn_bars:.2f})".format(**fit.per_point)
        axes.text(fit.per_point["estimated"], row, words, va="center", fontsize=7)
    before = found.first.per_point["estimated"]
    axes.axvline(before, color="black", lw=0.9, ls="--", label=f"no cause: {before:.1f}")
    axes.axvline(1.0, color="black", lw=0.9, ls=":", label="the noise")
    for words, colour in (("named", COLOURS["X"]), ("not excluded", "#d99a2b"), ("excluded", GREY)):
        axes.barh([0], [0], color=colour, label=words)
    axes.set_yticks(range(len(shown)), [" + ".join(name_hypothesis(fit)) for fit in shown], fontsize=7.5)
    axes.set(xscale="log", xlim=(None, 6 * before), xlabel="chi² per point, estimated noise")
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    figure: Figure = axes.figure
    return figure


def draw_change(found: CurveInvestigation) -> Figure:
    """Draw the change of C(nu) of each dipole by the named set and by the alternatives."""
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    frequency = found.fitter.station.channels_mhz
    for rank, fit in enumerate([found.last, *found.open[:MOST_LINES]]):
        change = found.fitter.calibration_change(found.first, fit)
        for panel, d in zip(axes, DIPOLES, strict=True):
            style: dict[str, Any] = {"lw": 1.1, "ls": "--"} if rank else {"color": "black", "lw": 2.0}
            panel.plot(frequency, 100 * change[d], label=" + ".join(name_hypothesis(fit)), **style)
    for panel, d in zip(axes, DIPOLES, strict=True):
        panel.axhline(0.0, color=GREY, lw=0.8)
        panel.set_title(f"dipole {d}", fontsize=10)
        panel.set_xlabel("frequency (MHz)")
    axes[0].set_ylabel("change of C (%)")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", fontsize=7.5, frameon=False, ncols=2
    )
    return figure


def name_hypothesis(fit: CurveFit) -> list[str]:
    """Each cause of a set with its size."""
    units = {"dipole_azimuth": "°", "lst_offset": " h"}
    return [
        f"{choice.cause.identifier.replace('_', ' ')} {choice.template.parameters.get('source', '')}".strip()
        + ("" if choice.is_statement else f" {size:.2f}{units.get(choice.cause.identifier, '')}")
        for choice, size in zip(fit.choices, fit.sizes.tolist(), strict=True)
    ]


def _combine(by_dipole: Any, name: str) -> Floats:
    return np.asarray(by_dipole["X"] - by_dipole["Y"] if name == "X - Y" else by_dipole[name])


def _errors(found: CurveInvestigation, name: str) -> tuple[float, Floats]:
    """Estimated and drawn error of a point; drawn bars of the difference as if the dipoles were independent."""
    sigma, drawn = found.fitter.noise.sigma_db, found.fitter.curve.error_db
    if name in DIPOLES:
        return sigma[name], drawn
    shared = 2 * found.fitter.noise.correlation * sigma["X"] * sigma["Y"]
    return float(np.sqrt(sigma["X"] ** 2 + sigma["Y"] ** 2 - shared)), drawn * np.sqrt(2.0)


def _smooth(values: Floats) -> Floats:
    """From the grid of the fit to a fine one, by its Fourier series."""
    return read_at(values[:, None], SMOOTH_HOURS)[:, 0]


def _spread(found: CurveInvestigation, name: str) -> float:
    """Standard deviation by which models differ, the same at every LST."""
    variance = dict(zip(DIPOLES, found.fitter.model_variance, strict=True))
    return float(np.sqrt(sum(variance.values()) if name == "X - Y" else variance[name]))


def draw_curve_page(content: dict[str, Any], found: CurveInvestigation) -> str:
    """The report of `lbacal_core.discovery.curve_search.describe_curve` as a page."""
    figures = {
        "curve": embed(draw_curve(found, found.fitter.curve.origin)),
        "ranking": embed(draw_ranking(found)),
        "change": embed(draw_change(found)),
    }
    return fill_report("curve.html", report=content, **figures)
