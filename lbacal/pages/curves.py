"""Charts of calibrations: C along frequency with both errors, how two compare, and the terms of the error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from lbacal.pages.chart import BAND, BARS, BLUE, IMAGE, LINE, OF_DIPOLE, POINTS, SKY, Chart, Series
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import OK, CalibrationCurve
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats

MICRO, PERCENT = 1e6, 100.0
FREQUENCY = "frequency (MHz)"
C_LABEL = "C ({} per ADC unit)"
SMALLEST_LIMIT = 0.5
"""Per cent: the colours of a residual map go no further down, else noise alone would fill them."""

TOTAL, STATISTICAL = "total error", "statistical"
"""Names of the bands of an error, said once in a chart."""


def draw_curves(title: str, curves: Sequence[CalibrationCurve], beside: Mapping[str, Any] | None = None) -> Chart:
    """C of some curves with the statistical error (dark) and the total (light); beside it others, name to (MHz, C)."""
    fitted = [curve for curve in curves if curve.c is not None]
    series: list[Series] = []
    for k, curve in enumerate(fitted):
        name = curve.name if len(fitted) == 1 else curve.dipole or curve.name
        series += _draw_curve(curve, name, OF_DIPOLE.get(str(curve.dipole), k % len(OF_DIPOLE) + 1), k == 0)
    for style, (name, (mhz, c)) in zip(cycle((1, 2, 3)), (beside or {}).items(), strict=False):
        series.append(Series(LINE, mhz, MICRO * np.asarray(c, dtype=float), name=name, style=style))
    return Chart(title, FREQUENCY, C_LABEL.format(unit_of_c(fitted)), series, y_limits=above_zero(series))


def unit_of_c(curves: Sequence[CalibrationCurve]) -> str:
    """Microvolts; of an antenna of 1 m^2, where no antenna gain was given."""
    return "µV by 1 m²" if curves and all(np.all(one.antenna_gain == 1.0) for one in curves) else "µV"


def above_zero(series: Sequence[Series]) -> tuple[float, float]:
    """An axis from 0 to a little above all bands."""
    return 0.0, 1.05 * max((float(np.nanmax(one.high)) for one in series if one.kind == BAND), default=1.0)


def _draw_curve(curve: CalibrationCurve, name: str, colour: int, is_first: bool) -> Iterator[Series]:
    mhz, c, stat, total = curve.frequency_mhz, *(MICRO * one for one in values_of(curve))
    yield Series(BAND, mhz, low=c - total, high=c + total, name=TOTAL * is_first, colour=colour)
    yield Series(BAND, mhz, low=c - stat, high=c + stat, name=STATISTICAL * is_first, colour=colour, style=1)
    errors = (
        f"± {s:.1f} % statistical, ± {t:.1f} % in all"
        for s, t in zip(*(PERCENT * np.array([stat, total]) / c), strict=True)
    )
    titles = [f"{name} {nu:g} MHz: {value:.2f} µV, {error}" for nu, value, error in zip(mhz, c, errors, strict=True)]
    yield Series(LINE, mhz, c, name=name, colour=colour, titles=titles)
    bad = np.flatnonzero(curve.flags != OK)
    told = [f"{name} {mhz[k]:g} MHz: {curve.flags[k]}" for k in bad]
    if told:
        yield Series(POINTS, mhz[bad], np.zeros(bad.size), name="flagged", titles=told)


def values_of(curve: CalibrationCurve) -> tuple[Floats, Floats, Floats]:
    """C, its statistical error, and that and the systematic one in quadrature, shape (freq,) each, V per ADC unit."""
    none = np.zeros(curve.frequency_mhz.size)
    stat = none if curve.c_sigma_stat is None else curve.c_sigma_stat
    sys = none if curve.c_sigma_sys is None else np.nan_to_num(curve.c_sigma_sys)
    return np.asarray(curve.c, dtype=float), np.asarray(stat), np.hypot(stat, sys)


def published_curve() -> dict[str, Any]:
    """The published calibration, to be drawn beside others: by its name MHz and V per ADC unit, shape (freq,) each."""
    table = read_table("published_calibration")
    return {"published (Mulrey et al. 2019)": (table["mhz"], table["c"])}


def draw_difference(first: CalibrationCurve, second: CalibrationCurve, names: tuple[str, str]) -> Chart:
    """The second over the first, with the statistical error of the second."""
    (before, _, _), (after, stat, _) = values_of(first), values_of(second)
    ratio, error = PERCENT * (after / before - 1.0), PERCENT * stat / before
    band = Series(
        BAND, first.frequency_mhz, low=ratio - error, high=ratio + error, name="statistical error", colour=BLUE
    )
    titles = [f"{nu:g} MHz: {value:+.2f} %" for nu, value in zip(first.frequency_mhz, ratio, strict=True)]
    line = Series(LINE, first.frequency_mhz, ratio, name=f"{names[1]} / {names[0]} - 1", colour=BLUE, titles=titles)
    return Chart(f"C of {names[1]} against {names[0]}", FREQUENCY, "difference of C (%)", [band, line])


def draw_terms(budget: Budget, statistical: Floats | None = None) -> Chart:
    """The terms of the error of C: root mean square over the band, the largest of the polarisations, largest first.

    `statistical` is the error of ln C, shape (freq,).
    """
    sizes = {one.name: max(_rms(one.variance(p)) for p in one.vectors) for one in budget.terms}
    if statistical is not None:
        sizes["statistical"] = _rms(statistical**2)
    ranked = sorted(sizes.items(), key=lambda pair: -pair[1])
    rows = [("all together", float(np.sqrt(sum(size**2 for size in sizes.values())))), *ranked]
    titles = [f"{name}: {PERCENT * size:.2f} % of C" for name, size in rows]
    bars = Series(BARS, [PERCENT * size for _, size in rows], range(len(rows)), colour=SKY, titles=titles)
    names = [name for name, _ in rows]
    return Chart(
        "terms of the error of C",
        "error of C, rms over the band (%)",
        "",
        [bars],
        rows=names,
        height=70 + 18 * len(rows),
    )


def _rms(variance: Floats) -> float:
    return float(np.sqrt(np.nanmean(variance)))


def draw_noise(mhz: Floats, terms: Mapping[str, Floats], title: str, unit: str = "K") -> Chart:
    """Draw the contributions to the power of a path, at the start of the chain, by their names, shape (freq,) each.

    `unit` is that of the numbers, for the axis.
    """
    series = []
    for k, (name, values) in enumerate(terms.items()):
        titles = [f"{name} {nu:g} MHz: {value:.4g} {unit}" for nu, value in zip(mhz, values, strict=True)]
        shown = name if np.any(values > 0) else f"{name}: negative"
        series.append(Series(LINE, mhz, values, name=shown, colour=k % 7, style=k // 7, titles=titles))
    return Chart(title, FREQUENCY, f"power ({unit})", series, scales=("linear", "log"))


def limit_residuals(maps: Iterable[Floats]) -> float:
    """Upper end of the colours, per cent, for maps of relative residuals of any shape: it holds 99 % of the points.

    NaN counts nowhere; it is `SMALLEST_LIMIT` at least.
    """
    known = np.concatenate([np.zeros(0), *(np.abs(one[np.isfinite(one)]) for one in maps)])
    return max(PERCENT * float(np.percentile(known, 99)) if known.size else 0.0, SMALLEST_LIMIT)


def draw_residuals(title: str, mhz: Floats, values: Floats, limit: float) -> Chart:
    """Measured over predicted power minus 1, a fraction, against LST and frequency, shape (lst, freq).

    `limit` is the upper end of the colours, per cent (`limit_residuals`).
    """
    extent = float(mhz[0]) - 0.5, float(mhz[-1]) + 0.5
    image = Series(IMAGE, extent, (0.0, 24.0), name="%", image=PERCENT * values, limit=limit)
    return Chart(title, FREQUENCY, "local sidereal time (h)", [image], y_limits=(0.0, 24.0))
