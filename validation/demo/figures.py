"""Charts of the demo's page: C against what was planted, and C over time with its step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lbacal.pages.chart import BAND, INK, LINE, MARK, OF_DIPOLE, POINTS, RED, WIDE, Chart, Series
from lbacal.pages.curves import FREQUENCY, PERCENT, draw_curves, published_curve, values_of
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.grids import Floats


def draw_calibration(stations: Sequence[CalibrationCurve], truth: Mapping[str, Floats]) -> list[Chart]:
    """C(nu) of a station's two dipoles beside the published curve and the planted one, and how far it is off that."""
    charts = []
    for curve in (one for one in stations if one.c is not None):
        planted = truth[str(curve.dipole)]
        beside = {"planted in the simulation": (curve.frequency_mhz, planted), **published_curve()}
        charts.append(draw_curves(f"C of {curve.name}, fitted", [curve], beside))
        c, stat, _ = values_of(curve)
        ratio, error, colour = PERCENT * (c / planted - 1.0), PERCENT * stat / planted, OF_DIPOLE[str(curve.dipole)]
        band = Series(BAND, curve.frequency_mhz, low=ratio - error, high=ratio + error, colour=colour)
        line = Series(
            LINE, curve.frequency_mhz, ratio, name="fitted / planted - 1, 1 standard deviation", colour=colour
        )
        charts.append(Chart(f"error of the fit of {curve.name}", FREQUENCY, "error of the fit (%)", [band, line]))
    return charts


def draw_drift(station: Mapping[str, Any], path: Mapping[str, Any]) -> Chart:
    """C of every month against the first year: a station's paths as a band, and one path with its step.

    Parameters
    ----------
    station, path
        Answers of ``GET /v1/drift``.
    """

    def at(points: Sequence[Mapping[str, Any]]) -> Floats:
        months = np.array([point["month"] for point in points], dtype="datetime64[M]") + np.timedelta64(14, "D")
        return months.astype("datetime64[s]").astype(float)

    def values(points: Sequence[Mapping[str, Any]], name: str) -> Floats:
        return np.array([point[name] for point in points])

    band, one, whose = station["months"], path["months"], f"antenna {path['antenna']} {path['dipole']}"
    of_paths = f"{station['station']}, {band[0]['paths']} paths: "
    low, high, c = values(band, "low"), values(band, "high"), values(one, "c_ratio")
    error = values(one, "high") - c
    series = [
        Series(BAND, at(band), low=low, high=high, name=f"{of_paths}middle 68 %"),
        Series(LINE, at(band), values(band, "c_ratio"), name=f"{of_paths}median", colour=INK),
        Series(POINTS, at(one), c, c - error, c + error, whose, OF_DIPOLE[path["dipole"]]),
    ]
    for step in path["steps"][:1]:
        size = f"step of {whose}: {100 * step['size']:+.1f} ± {100 * step['sigma']:.1f} %, {step['date']}"
        date = float(np.datetime64(step["date"], "s").astype(int))
        series.append(Series(MARK, [date], name=size, colour=RED, style=1, titles=[size]))
    return Chart("C over time", "month (UTC)", "C / C of the first year", series, ("time", "linear"), width=WIDE)
