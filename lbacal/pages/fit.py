"""The page of a fit: its table, its figure, and the error of C for one event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np

from lbacal.pages.chart import BAND, BLUE, LINE, MARK, OF_DIPOLE, POINTS, RED, SKY, Chart, Series
from lbacal.pages.curves import (
    C_LABEL,
    FREQUENCY,
    MICRO,
    STATISTICAL,
    TOTAL,
    above_zero,
    draw_curves,
    draw_noise,
    draw_residuals,
    draw_terms,
    limit_residuals,
    unit_of_c,
)
from lbacal.pages.report import Origin, fill_report
from lbacal_core.calibration.budget import largest_chi2_per_dof
from lbacal_core.calibration.channels import LARGEST_GOOD_ERROR
from lbacal_core.calibration.one_event import ErrorOfC, map_departures
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import MISFIT, OK, CalibrationCurve, FitReport
from lbacal_core.grids import WITHIN_1_SIGMA, Floats
from lbacal_core.simulation.simulation import Simulation, noise_at_input
from lbacal_core.spectra.blocks import iterate_blocks
from lbacal_core.spectra.spectra import Spectra

MOST_ROWS = 16
"""More curves are told by station and polarisation."""
SHOWN_CHANNELS = 3
HEADER = ("", "curves", "events", "LST", "chi2/dof", "sky free", "flagged")


def tabulate_curves(curves: Sequence[CalibrationCurve]) -> list[list[str]]:
    """Header and rows: curves one by one, or if there are many those of a station and polarisation together."""
    frequency = curves[0].frequency_mhz
    at = np.unique(np.linspace(0, frequency.size - 1, SHOWN_CHANNELS).round().astype(int))
    groups: dict[str, list[CalibrationCurve]] = {}
    for curve in curves:
        together = " ".join(part for part in (curve.station, curve.dipole) if part)
        groups.setdefault(curve.name if len(curves) <= MOST_ROWS else together, []).append(curve)
    header = [*HEADER, *(f"C({frequency[k]:g} MHz), {unit_of_c(curves)} ±stat.% ±syst.%" for k in at)]
    return [header, *(_row(name, group, at) for name, group in groups.items())]


def _row(name: str, group: Sequence[CalibrationCurve], at: np.ndarray) -> list[str]:
    with_values = [curve for curve in group if curve.c is not None]
    statuses = [curve.status for curve in group]
    counted = ", ".join(f"{statuses.count(one)} {one}" for one in dict.fromkeys(statuses))
    first = [name, statuses[0] if len(group) == 1 else counted, _range([float(c.events) for c in group], "{:.0f}")]
    first.append(_range([curve.lst_coverage for curve in group], "{:.2f}"))
    if not with_values:
        return [*first, *[""] * (3 + at.size)]
    flagged = sum(int(np.sum(curve.flags != OK)) for curve in with_values)
    cells = []
    for k in at:
        known = [curve for curve in with_values if curve.has_value[k]]
        cells.append(_value(known, int(k)) if known else "outside")
    return [
        *first,
        _range([float(curve.chi2_per_dof or np.nan) for curve in with_values], "{:.2f}"),
        _range([float(curve.chi2_per_dof_profiled or np.nan) for curve in with_values], "{:.2f}"),
        f"{flagged} of {sum(curve.frequency_mhz.size for curve in with_values)}",
        *cells,
    ]


def _value(curves: Sequence[CalibrationCurve], k: int) -> str:
    """C in one channel, microvolts, with both errors in per cent: the median of several curves."""

    def median(name: str) -> float:
        found = [float(values[k]) for curve in curves if (values := getattr(curve, name)) is not None]
        return float(np.median(found)) if found else float("nan")

    c = median("c")
    return f"{1e6 * c:.3g} ±{100 * median('c_sigma_stat') / c:.1f} ±{100 * median('c_sigma_sys') / c:.0f}"


def _range(values: Sequence[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low}-{high}"


def explain_chi2(curves: Sequence[CalibrationCurve]) -> str:
    """Explain the two numbers of the chain test for these channels, and why some are flagged."""
    dof = curves[0].frequency_mhz.size - 3
    misfits = sum(curve.status == MISFIT for curve in curves)
    widened = sum(
        1 for c in curves if c.status != MISFIT and (c.chi2_per_dof or 0.0) > largest_chi2_per_dof(c.frequency_mhz.size)
    )
    limit, sigma = largest_chi2_per_dof(dof + 3), np.sqrt(2.0 / dof)
    flags = [flag for curve in curves if curve.c is not None for flag in curve.flags.tolist() if flag != OK]
    counted = ", ".join(f"{flags.count(flag)} channels {flag}" for flag in dict.fromkeys(flags))
    flagged = (
        f" Flagged: {counted}; uncertain: a misfit, a statistical error above {LARGEST_GOOD_ERROR:.0%}, or another "
        "antenna with a probability above 1 % by these data moves C by more."
    )
    return (
        f"chi2/dof tests the chain along frequency: 1.0 ± {sigma:.1f} ({dof} degrees of freedom) if nothing but noise "
        f"parts data and model; above {limit:.1f} the systematic error of a curve is widened ({widened} here). "
        "'sky free' looks along LST as well, and lets sky and pattern differ by what is known of them: 1 or less if "
        "they explain the rest. A misfit is where even that is less probable than 1e-6, where a likely mistake is "
        f"named, where gains follow sidereal time, and every curve of a station half of whose are one ({misfits} here)."
        + (flagged if flags else "")
    )


def describe_error(error: ErrorOfC) -> str:
    """One line with one number: the error of C for one event on one antenna, beside that of the mean."""
    parts = [f"statistical {_percent(error.statistical)}", f"systematic {_percent(error.systematic)}"]
    of_mean = f"for the mean of the events: {_percent(error.of_mean)}"
    more = [f"single antennas {_percent(error.antenna)}"] if error.antenna != 0.0 else []
    more.append(f"gain of an event {_percent(error.event)}")
    terms = ", ".join([*parts, *more])
    return f"error of C for one event on one antenna: {_percent(error.of_one_event)} ({terms}); {of_mean}"


def _percent(fraction: float) -> str:
    return "unknown" if not np.isfinite(fraction) else f"{100 * fraction:.1f} %"


def draw_page(report: FitReport, charts: Sequence[Chart], origin: Origin, sentences: Sequence[str]) -> str:
    """Draw the report as one HTML file.

    Parameters
    ----------
    charts
        From `draw_fit`.
    sentences
        What the command printed beside its table; the first is the error of C.
    """
    rows = tabulate_curves(report.curves)
    every = [] if len(report.curves) <= MOST_ROWS else [
        row for curve in report.curves for row in tabulate_curves([curve])[1:]
    ]  # fmt: skip
    return fill_report(
        "fit.html",
        sentences=list(sentences),
        header=rows[0],
        rows=rows[1:],
        every=every,
        chi2=explain_chi2(report.curves),
        charts=charts,
        budgets=[draw_terms(budget) for budget in report.budgets.values()],
        terms=[_describe_terms(budget) for budget in report.budgets.values()],
        made_from=origin,
    )


def _describe_terms(budget: Budget) -> dict[str, object]:
    """Rows of the budget: name, largest standard deviation of C in per cent for each polarisation, source."""
    rows = [
        [term.name, " / ".join(f"{100 * float(term.variance(p).max()) ** 0.5:.1f}" for p in term.vectors), term.source]
        for term in budget.terms
    ]
    return {"digest": budget.digest, "rows": rows, "polarisations": " / ".join(budget.terms[0].vectors)}


# The figures of a fit, of each polarisation: C with its errors, residual map, noise terms and chi2.

LARGEST_LINEAR = 5.0
"""A chi2 per degree of freedom above which a linear axis would show the good curves as one line."""


def average_residuals(
    spectra: Spectra, curves: Sequence[CalibrationCurve], simulation: Simulation
) -> dict[str, Floats]:
    """Maps of relative residuals by polarisation, the mean over stations, shape (lst, freq).

    NaN where nothing was measured.
    """
    maps: dict[str, list[Floats]] = {}
    for block in iterate_blocks(spectra):
        maps.setdefault(block.dipole, []).append(map_departures(block, curves, simulation))
    means = {}
    for dipole, found in sorted(maps.items()):
        known = np.isfinite(found)
        with np.errstate(invalid="ignore"):
            means[dipole] = np.where(known, found, 0.0).sum(axis=0) / known.sum(axis=0)
    return means


def draw_fit(report: FitReport, maps: Mapping[str, Floats], simulation: Simulation) -> list[Chart]:
    """The charts of a fit, of each kind those of all polarisations.

    Parameters
    ----------
    maps
        From `average_residuals`.
    """
    curves = [curve for curve in report.curves if curve.c is not None]
    limit, found = limit_residuals(maps.values()), list[list[Chart]]()
    for dipole in sorted({str(curve.dipole) for curve in curves}) or list(maps):
        own = [curve for curve in curves if curve.dipole == dipole]
        charts = [draw_c(own, f"C, polarisation {dipole}")]
        if dipole in maps:
            title = f"measured / predicted power - 1, polarisation {dipole}"
            charts.append(draw_residuals(title, simulation.instrument.frequency_mhz, maps[dipole], limit))
        if own:
            sky = simulation.sky_power.power[dipole].mean(axis=0)
            charts += [_draw_noise(own, simulation, sky, dipole), _draw_chi2(own, dipole)]
        found.append(charts)
    return [chart for of_kind in zip_longest(*found) for chart in of_kind if chart is not None]


def draw_c(curves: Sequence[CalibrationCurve], title: str = "C") -> Chart:
    """C of a curve for each polarisation, or the median of several with the middle 68 %."""
    fitted = [curve for curve in curves if curve.c is not None]
    of_dipole = {
        name: [one for one in fitted if one.dipole == name] for name in sorted({str(c.dipole) for c in fitted})
    }
    if all(len(own) == 1 for own in of_dipole.values()):
        return draw_curves(title, fitted)
    series: list[Series] = []
    for at, (dipole, own) in enumerate(of_dipole.items(), start=1):
        mhz, colour, c = own[0].frequency_mhz, OF_DIPOLE.get(dipole, at), np.array([one.c for one in own], dtype=float)
        middle = np.nanmedian(c, axis=0)
        stat, sys = (_median_error(own, name) for name in ("c_sigma_stat", "c_sigma_sys"))
        for style, (error, label) in enumerate(((np.hypot(stat, np.nan_to_num(sys)), TOTAL), (stat, STATISTICAL))):
            low, high = (MICRO * middle * (1.0 + sign * error) for sign in (-1, 1))
            series.append(Series(BAND, mhz, low=low, high=high, name=f"{dipole}: {label}", colour=colour, style=style))
        low, high = MICRO * np.nanpercentile(c, WITHIN_1_SIGMA, axis=0)
        series += [Series(LINE, mhz, low, name="68 % of the curves", style=1), Series(LINE, mhz, high, style=1)]
        series.append(Series(LINE, mhz, MICRO * middle, name=f"{dipole}: median of {len(own)} curves", colour=colour))
        flagged = mhz[np.mean([curve.flags != OK for curve in own], axis=0) > 0.5]
        series.append(Series(POINTS, flagged, np.zeros(flagged.size), name="flagged" if flagged.size else ""))
    return Chart(title, FREQUENCY, C_LABEL.format(unit_of_c(fitted)), series, y_limits=above_zero(series))


def _median_error(curves: Sequence[CalibrationCurve], name: str) -> Floats:
    found = [values / np.asarray(curve.c) for curve in curves if (values := getattr(curve, name)) is not None]
    return np.asarray(np.nanmedian(found, axis=0)) if found else np.full(curves[0].frequency_mhz.shape, np.nan)


def _draw_noise(curves: Sequence[CalibrationCurve], simulation: Simulation, sky: Floats, dipole: str) -> Chart:
    """Sky and noise terms at the start of the chain, medians of the curves."""
    found = [noise_at_input(curve, simulation.instrument) for curve in curves]
    terms = {"sky, mean over LST": sky}
    terms |= {
        f"N_{name.removesuffix('_noise').upper()}": np.nanmedian([one[name] for one in found], axis=0)
        for name in found[0]
    }
    title = f"power at the start of the chain, polarisation {dipole}"
    unit = "W m⁻² MHz⁻¹" if simulation.given is None else "unit of the sky power file"
    return draw_noise(simulation.instrument.frequency_mhz, terms, title, unit)


def _draw_chi2(curves: Sequence[CalibrationCurve], dipole: str) -> Chart:
    """Both numbers of the chain test for every curve, and what noise alone makes of the first."""
    channels, at = curves[0].frequency_mhz.size, np.arange(1, len(curves) + 1)
    sigma, widened = 2.0 * float(np.sqrt(2.0 / (channels - 3))), largest_chi2_per_dof(channels)
    ends = [0.5, len(curves) + 0.5]
    series = [Series(BAND, ends, low=[1 - sigma] * 2, high=[1 + sigma] * 2, name="expected of noise, 95 %")]
    series.append(Series(LINE, ends, [widened] * 2, name="errors are widened above", style=1))
    largest = widened
    for name, label, colour in (
        ("chi2_per_dof", "noise alone", BLUE),
        ("chi2_per_dof_profiled", "sky and pattern free", RED),
    ):
        values = np.array([getattr(curve, name) or np.nan for curve in curves], dtype=float)
        titles = [f"{curve.name}, {label}: {value:.2f}" for curve, value in zip(curves, values, strict=True)]
        series.append(Series(POINTS, at, values, name=label, colour=colour, titles=titles))
        largest = max(largest, float(np.nanmax(np.append(values, 0.0))))
    wrong = [k for k, curve in zip(at, curves, strict=True) if curve.status == MISFIT]
    series.append(Series(MARK, wrong, name="misfit" if wrong else "", colour=SKY, style=2))
    scales = ("linear", "log" if largest > LARGEST_LINEAR else "linear")
    label, title = "chi² per degree of freedom", f"chain test, polarisation {dipole}"
    limits = None if largest > LARGEST_LINEAR else (0.0, 1.5 * max(largest, 1 + sigma))
    return Chart(title, "curve, in the order of the table", label, series, scales, (0.5, len(curves) + 0.5), limits)
