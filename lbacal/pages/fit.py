"""The page of a fit: its table, its figure, and the error of C for one event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.fit_summary import MOST_ROWS, explain_chi2, tabulate_curves
from lbacal.pages.report import COLOURS, DIPOLE_COLOURS, GREY, embed, fill_report
from lbacal_core.calibration.budget import largest_chi2_per_dof
from lbacal_core.calibration.one_event import map_departures
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import MISFIT, OK, CalibrationCurve, FitReport
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation, noise_at_input
from lbacal_core.spectra.blocks import iterate_blocks
from lbacal_core.spectra.spectra import Spectra


def draw_page(report: FitReport, figure: Figure, source: str, sentences: Sequence[str]) -> str:
    """The report as one HTML file.

    Parameters
    ----------
    sentences
        What the command printed beside its table; the first is the error of C.
    """
    rows = tabulate_curves(report.curves)
    every = [] if len(report.curves) <= MOST_ROWS else [
        row for curve in report.curves for row in tabulate_curves([curve])[1:]
    ]  # fmt: skip
    return fill_report(
        "fit.html",
        source=source,
        sentences=list(sentences),
        header=rows[0],
        rows=rows[1:],
        every=every,
        chi2=explain_chi2(report.curves),
        figure=embed(figure),
        terms=[_describe_terms(budget) for budget in report.budgets.values()],
        notes=report.provenance.notes,
        inputs=report.provenance.inputs,
    )


def _describe_terms(budget: Budget) -> dict[str, object]:
    """Rows of the budget: name, largest standard deviation of C in per cent for each polarisation, source."""
    rows = [
        [term.name, " / ".join(f"{100 * float(term.variance(p).max()) ** 0.5:.1f}" for p in term.vectors), term.source]
        for term in budget.terms
    ]
    return {"digest": budget.digest, "rows": rows, "polarisations": " / ".join(budget.terms[0].vectors)}


# The figure of a fit: C with its bands, residual maps, noise terms and chi2, a column for each polarisation.

WITHIN_1_SIGMA = (15.87, 84.13)
SMALLEST_LIMIT = 0.5
"""Per cent: the colours of a residual map go no further down, else noise alone would fill them."""
LARGEST_LINEAR = 5.0
"""A chi2 per degree of freedom above which a linear axis would show the good curves as one line."""
LEGEND_ROOM = 1.45
STYLES = ("--", "-.", ":", (0, (5, 1)), (0, (1, 3)), (0, (3, 1, 1, 1)), (0, (7, 3)))
"""Lines of the noise terms, in the order of the chain."""


def average_residuals(
    spectra: Spectra, curves: Sequence[CalibrationCurve], simulation: Simulation
) -> dict[str, Floats]:
    """Residual maps of each polarisation, the mean over stations, shape (lst, freq); NaN where nothing was measured."""
    maps: dict[str, list[Floats]] = {}
    for block in iterate_blocks(spectra):
        maps.setdefault(block.dipole, []).append(map_departures(block, curves, simulation))
    means = {}
    for dipole, found in sorted(maps.items()):
        known = np.isfinite(found)
        with np.errstate(invalid="ignore"):
            means[dipole] = np.where(known, found, 0.0).sum(axis=0) / known.sum(axis=0)
    return means


def draw_fit(report: FitReport, maps: Mapping[str, Floats], simulation: Simulation) -> Figure:
    """All of a fit on one page.

    Parameters
    ----------
    maps
        From `average_residuals`.
    """
    curves = [curve for curve in report.curves if curve.c is not None]
    dipoles = sorted({str(curve.dipole) for curve in curves}) or list(maps)
    figure = Figure(figsize=(4.9 * len(dipoles), 13.5), layout="constrained")
    axes: Any = figure.subplots(4, len(dipoles), squeeze=False, sharey="row", height_ratios=[1.3, 1, 1, 0.8])
    image = None
    for column, dipole in zip(axes.T, dipoles, strict=True):
        own = [curve for curve in curves if curve.dipole == dipole]
        _draw_c(column[0], own, dipole)
        image = _draw_map(column[1], maps, dipole, simulation.instrument.frequency_mhz) or image
        _draw_noise(column[2], own, simulation.instrument, simulation.sky_power.power[dipole].mean(axis=0))
        _draw_chi2(column[3], own)
    if image is not None:
        figure.colorbar(image, ax=axes[1], label="measured / predicted - 1 (%)")
    axes[0, 0].set_ylabel("C (V per ADC unit)")
    axes[1, 0].set_ylabel("local sidereal time (h)")
    axes[2, 0].set_ylabel("power at the start of the chain\n(unit of P_sky)")
    axes[3, 0].set_ylabel("chi² per degree of freedom")
    return figure


def draw_c(axes: Any, curves: Sequence[CalibrationCurve]) -> None:
    """C of every dipole on one pair of axes."""
    fitted = [curve for curve in curves if curve.c is not None]
    for dipole in sorted({str(curve.dipole) for curve in fitted}):
        _draw_c(axes, [curve for curve in fitted if str(curve.dipole) == dipole], dipole)
    axes.set(title="", xlabel="frequency (MHz)", ylabel="C (V per ADC unit)")


def _draw_c(axes: Any, curves: Sequence[CalibrationCurve], dipole: str) -> None:
    """C of one curve, or the median of several, with the statistical and the total error."""
    axes.set(title=f"polarisation {dipole}", xlabel="frequency (MHz)")
    if not curves:
        return
    frequency, colour = curves[0].frequency_mhz, DIPOLE_COLOURS.get(dipole, COLOURS[0])
    c = np.array([curve.c for curve in curves], dtype=float)
    middle = np.nanmedian(c, axis=0)
    stat, sys = (_median_error(curves, name) for name in ("c_sigma_stat", "c_sigma_sys"))
    total = np.hypot(stat, np.nan_to_num(sys))
    name = curves[0].name if len(curves) == 1 else f"median of {len(curves)} curves"
    for error, alpha, label in ((total, 0.2, "total error"), (stat, 0.6, "statistical error")):
        below, above = middle * (1 - error), middle * (1 + error)
        axes.fill_between(frequency, below, above, color=colour, alpha=alpha, lw=0, label=label)
    if len(curves) > 1:
        low, high = np.nanpercentile(c, WITHIN_1_SIGMA, axis=0)
        axes.plot(frequency, low, color=GREY, lw=0.9, ls="--", label="68 % of the curves")
        axes.plot(frequency, high, color=GREY, lw=0.9, ls="--")
    axes.plot(frequency, middle, color=colour, lw=1.4, label=name)
    flagged = np.mean([curve.flags != OK for curve in curves], axis=0) > 0.5
    if np.any(flagged):
        axes.plot(
            frequency[flagged], np.zeros(flagged.sum()), "x", color="black", ms=4, clip_on=False,
            transform=axes.get_xaxis_transform(), label="flagged",
        )  # fmt: skip
    axes.legend(fontsize=8, frameon=False)


def _median_error(curves: Sequence[CalibrationCurve], name: str) -> Floats:
    found = [values / np.asarray(curve.c) for curve in curves if (values := getattr(curve, name)) is not None]
    return np.asarray(np.nanmedian(found, axis=0)) if found else np.full(curves[0].frequency_mhz.shape, np.nan)


def _draw_map(axes: Any, maps: Mapping[str, Floats], dipole: str, frequency_mhz: Floats) -> Any:
    """Measured over predicted power against LST and frequency."""
    axes.set(xlabel="frequency (MHz)", ylim=(0, 24), yticks=range(0, 25, 6))
    if dipole not in maps or not np.any(np.isfinite(list(maps.values()))):
        return None
    limit = max(100 * float(np.nanpercentile(np.abs(np.stack(list(maps.values()))), 99)), SMALLEST_LIMIT)
    extent = (frequency_mhz[0] - 0.5, frequency_mhz[-1] + 0.5, 0.0, 24.0)
    axes.set_facecolor("0.85")
    return axes.imshow(
        100 * maps[dipole], origin="lower", aspect="auto", extent=extent, cmap="RdBu_r", vmin=-limit, vmax=limit,
        interpolation="nearest",
    )  # fmt: skip


def _draw_noise(axes: Any, curves: Sequence[CalibrationCurve], instrument: Instrument, sky: Floats) -> None:
    """Sky and noise terms at the start of the chain, medians of the curves."""
    axes.set(xlabel="frequency (MHz)", yscale="log")
    if not curves:
        return
    found = [noise_at_input(curve, instrument) for curve in curves]
    lines: list[tuple[str, Floats, Any]] = [("sky, mean over LST", sky, "-")]
    for name, style in zip(found[0], cycle(STYLES), strict=False):
        lines.append((f"N_{name.upper()}", np.nanmedian([one[name] for one in found], axis=0), style))
    for (label, values, style), colour in zip(lines, cycle(COLOURS), strict=False):
        axes.plot(
            instrument.frequency_mhz, np.where(values > 0, values, np.nan), linestyle=style, color=colour, label=label
        )
    axes.legend(fontsize=8, frameon=False, ncols=2)


def _draw_chi2(axes: Any, curves: Sequence[CalibrationCurve]) -> None:
    """Both numbers of the chain test for every curve, and what noise alone makes of the first."""
    axes.set(xlabel="curve, in the order of the table")
    axes.xaxis.get_major_locator().set_params(integer=True)
    if not curves:
        return
    channels = curves[0].frequency_mhz.size
    at = np.arange(1, len(curves) + 1)
    sigma = float(np.sqrt(2.0 / (channels - 3)))
    axes.axhspan(1 - 2 * sigma, 1 + 2 * sigma, color=GREY, alpha=0.2, lw=0, label="expected of noise, 95 %")
    largest = largest_chi2_per_dof(channels)
    axes.axhline(largest, color=GREY, lw=0.9, ls="--", label="errors are widened above")
    for name, label, style in (
        ("chi2_per_dof", "noise alone", {"marker": "o", "color": COLOURS[2]}),
        ("chi2_per_dof_profiled", "sky and pattern free", {"marker": "^", "mfc": "white", "color": COLOURS[1]}),
    ):
        values = np.array([getattr(curve, name) or np.nan for curve in curves], dtype=float)
        axes.plot(at, values, ls="none", ms=3.5, label=label, **style)
        largest = max(largest, float(np.nanmax(np.append(values, 0.0))), axes.get_ylim()[1] / LEGEND_ROOM)
    wrong = np.array([curve.status == MISFIT for curve in curves])
    if np.any(wrong):
        axes.plot(at[wrong], np.zeros(wrong.sum()), "x", color="black", clip_on=False, label="misfit",
                  transform=axes.get_xaxis_transform())  # fmt: skip
    if largest > LARGEST_LINEAR:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    axes.set(xlim=(0.5, len(curves) + 0.5), ylim=(None if largest > LARGEST_LINEAR else 0.0, LEGEND_ROOM * largest))
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(fontsize=7.5, frameon=False, ncols=2)
