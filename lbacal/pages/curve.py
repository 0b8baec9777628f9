"""LST curves: what was measured, the simulation beside it, what each hypothesis does, and the HTML report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lbacal.pages.chart import BAND, BARS, BLUE, GREEN, INK, LINE, MARK, OF_DIPOLE, ORANGE, POINTS, RED, Chart, Series
from lbacal.pages.curves import FREQUENCY, PERCENT
from lbacal.pages.report import Origin, fill_report
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.curve_search import CurveInvestigation
from lbacal_core.grids import Floats
from lbacal_core.lstcurve.curve import AS_RECORDED, Comparison, band_weights, in_db, simulate_band_power
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import read_at

COLOURS = OF_DIPOLE | {"X - Y": GREEN}
SMOOTH_HOURS = np.linspace(0.0, 24.0, 193)
MOST_LINES = 5
LST, DAY = "local sidereal time (h)", (0.0, 24.0)
MEASURED, LEFT = "band power, relative to LST 0 (dB)", "measured - simulated (dB)"


def draw_comparison(comparison: Comparison, simulation: Simulation) -> Iterator[Chart]:
    """Measured curve of each dipole, the simulation with and without noise, and what is left."""
    curve, weights = comparison.curve, band_weights(simulation.instrument, AS_RECORDED, comparison.band_mhz)
    for dipole in DIPOLES:
        power = simulate_band_power(simulation.sky_power, dipole, SMOOTH_HOURS, weights)
        top = [_points(curve.lst_hours, curve.variation_db[dipole], curve.error_db, f"measured, {dipole}", dipole)]
        below = []
        noisy = comparison.of(dipole, has_noise=True)
        for has_noise, style in ((False, 1), (True, 0))[noisy.noise_share == 0.0 :]:  # without noise both are one
            fit = comparison.of(dipole, has_noise=has_noise)
            words = f"sky and {PERCENT * fit.noise_share:.0f} % noise" if has_noise else "sky alone"
            level = in_db(power, fit.noise_share) + fit.offset_db
            name = f"{words}: chi² per point {fit.chi2 / fit.points:.1f}"
            top.append(Series(LINE, SMOOTH_HOURS, level, name=name, style=style))
            error = curve.error_db if has_noise else np.zeros(curve.error_db.shape)
            below.append(_points(curve.lst_hours, fit.residual_db, error, words, dipole if has_noise else ""))
        yield from _pair(f"dipole {dipole}", top, below)


def draw_curve(found: CurveInvestigation) -> Iterator[Chart]:
    """X, Y and their difference with both error bars, the simulation before and after, and what both leave."""
    curve, hours = found.fitter.curve, found.fitter.curve.lst_hours
    for name in COLOURS:
        estimated, drawn = _errors(found, name)
        measured = _combine(curve.variation_db, name)
        top = [
            _points(hours, measured, drawn, "bars as drawn", ""),
            _points(hours, measured, estimated, f"measured, {name}; noise {estimated:.3f} dB", name),
        ]
        for fit, style, words in ((found.first, 1, "before"), (found.last, 0, "after")):
            told = f"simulation {words}: chi² per point {fit.chi2_drawn / fit.points:.1f}"
            top.append(Series(LINE, SMOOTH_HOURS, _smooth(_combine(fit.curve_db, name)), name=told, style=style))
        if found.fitter.has_model_spread:
            spread, middle = _spread(found, name), _smooth(_combine(found.last.curve_db, name))
            low, high, words = middle - spread, middle + spread, "spread of sky and antenna models"
            top.append(Series(BAND, SMOOTH_HOURS, low=low, high=high, name=words))
        before, after = (_combine(fit.residual_db, name) for fit in (found.first, found.last))
        below = [_points(hours, before, 0.0, "before", ""), _points(hours, after, estimated, "after", name)]
        yield from _pair(name if name in DIPOLES else "difference X - Y", top, below)


def _pair(title: str, top: Sequence[Series], below: Sequence[Series]) -> tuple[Chart, Chart]:
    """A curve and what the simulation leaves of it, over local sidereal time."""
    zero = Series(LINE, DAY, (0.0, 0.0))
    left = Chart(f"{title}: measured less simulated", LST, LEFT, [zero, *below], x_limits=DAY)
    return Chart(f"{title}: measured and simulated", LST, MEASURED, top, x_limits=DAY), left


def _points(hours: Floats, values: Floats, error: Floats | float, words: str, name: str) -> Series:
    """Points in the colour of a dipole or of the difference, or in ink."""
    return Series(POINTS, hours, values, values - error, values + error, words, COLOURS.get(name, INK))


def draw_ranking(found: CurveInvestigation) -> Chart:
    """Chi^2 of every cause by itself, and of the sets that the data cannot exclude."""
    shown, standing = zip(*found.hypotheses, strict=True)
    series = []
    for words, colour in (("named", RED), ("not excluded", ORANGE), ("excluded", BLUE)):
        at = [k for k, one in enumerate(standing) if one == words]
        told = ["{estimated:.2f} (drawn bars {drawn_bars:.2f})".format(**shown[k].per_point) for k in at]
        values = [shown[k].per_point["estimated"] for k in at]
        series.append(Series(BARS, values, at, name=words, colour=colour, titles=told))
    before = found.first.per_point["estimated"]
    series += [
        Series(MARK, [before], name=f"no cause: {before:.1f}", style=1),
        Series(MARK, [1.0], name="the noise", style=2),
    ]
    rows = [" + ".join(name_hypothesis(fit)) for fit in shown]
    label, title = "chi² per point, estimated noise", "every hypothesis"
    return Chart(title, label, "", series, rows=rows, height=90 + 18 * len(rows))


def draw_change(found: CurveInvestigation) -> Iterator[Chart]:
    """Draw the change of C(nu) of each dipole by the named set and by the alternatives."""
    shown = [found.last, *found.open[:MOST_LINES]]
    change = [(fit, found.fitter.calibration_change(found.first, fit)) for fit in shown]
    for dipole in DIPOLES:
        series = [
            Series(
                LINE, found.fitter.station.channels_mhz, PERCENT * of_fit[dipole],
                name=" + ".join(name_hypothesis(fit)), colour=k, style=int(k > 0),
            )
            for k, (fit, of_fit) in enumerate(change)
        ]  # fmt: skip
        yield Chart(f"change of C, dipole {dipole}", FREQUENCY, "change of C (%)", series)


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


def draw_curve_page(content: dict[str, Any], found: CurveInvestigation, origin: Origin) -> str:
    """The report of `lbacal_core.discovery.curve_search.describe_curve` as a page."""
    curve, change = list(draw_curve(found)), list(draw_change(found))
    return fill_report(
        "curve.html", report=content, curve=curve, ranking=[draw_ranking(found)], change=change, made_from=origin
    )
