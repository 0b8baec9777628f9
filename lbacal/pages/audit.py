"""The page of an audit: its lines as a table, every path against the others, and what the station saw of the sky."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.report import COLOURS, DIPOLE_COLOURS, GREY, embed, fill_report
from lbacal_core.audit.antennas import compare_paths
from lbacal_core.audit.audit import AuditReport
from lbacal_core.audit.station import AuditedStation

SHORTEST_HOURS = 0.5
LARGEST_DB = 3.0


def draw_page(report: AuditReport, source: str) -> str:
    """Draw the report as HTML."""
    stations = [
        {"name": station.name, "figure": embed(draw_stations([station])), "hours": station.hours}
        for station in report.stations
    ]
    lines = [line.as_dict() for line in report.lines]
    return fill_report("audit.html", source=source, healthy=report.is_healthy, lines=lines, stations=stations)


def draw_stations(stations: Sequence[AuditedStation]) -> Figure:
    """Departure of every path from the median of its polarisation and cable name, and band power against LST."""
    shown = [(station, is_sky) for station in stations for is_sky in (False, True)
             if not is_sky or station.hours >= SHORTEST_HOURS]  # fmt: skip
    columns = max(len(station.dipoles) for station in stations)
    figure = Figure(figsize=(5 * columns, 3.75 * len(shown)), layout="constrained")
    rows: Any = figure.subplots(len(shown), columns, squeeze=False, sharey="row")
    for axes, (station, is_sky) in zip(rows, shown, strict=True):
        if is_sky:
            for column in range(len(station.dipoles)):
                _draw_sky(axes[column], station, column)
        else:
            images = [draw_departures(axes[column], station, column) for column in range(len(station.dipoles))]
            figure.colorbar(images[0], ax=axes, label="power over the median of the cable name (dB)")
    return figure


def draw_departures(axes: Any, station: AuditedStation, column: int) -> Any:
    """Departure of the paths of one dipole from the median of its cable name."""
    comparison = compare_paths(station)
    departure = 10 / np.log(10) * (comparison.level[..., None] + comparison.profile)[:, column]
    rows = np.arange(station.antennas.size + 1) - 0.5
    image = axes.pcolormesh(
        _edges(station.frequency_mhz), rows, departure, cmap="RdBu_r", vmin=-LARGEST_DB, vmax=LARGEST_DB
    )
    axes.set(xlabel="frequency (MHz)", title=f"{station.name} {station.dipoles[column]}")
    ticks = np.unique(np.linspace(0, station.antennas.size - 1, 13).astype(int))
    axes.set_yticks(ticks, [str(a) for a in station.antennas[ticks]])
    if column == 0:
        axes.set_ylabel("antenna")
    return image


def _draw_sky(axes: Any, station: AuditedStation, column: int) -> None:
    """Band power of one dipole against LST, every path and their median."""
    dipole, order = station.dipoles[column], np.argsort(station.lst_hours)
    band = 10 / np.log(10) * np.nanmean(station.before_cable()[:, column], axis=-1)
    band = band - np.nanmedian(band, axis=-1, keepdims=True)
    axes.plot(station.lst_hours[order], band[:, order].T, color=GREY, lw=0.4, alpha=0.5)
    median, colour = np.nanmedian(band, axis=0)[order], DIPOLE_COLOURS.get(dipole, COLOURS[3])
    axes.plot(station.lst_hours[order], median, ".-", color=colour, label="median")
    axes.set(xlabel="local sidereal time (h)", xlim=(0, 24))
    axes.legend(frameon=False)
    if column == 0:
        axes.set_ylabel("power of the band over its median (dB)")


def _edges(frequency_mhz: np.ndarray) -> np.ndarray:
    if frequency_mhz.size == 1:
        return np.array([frequency_mhz[0] - 0.5, frequency_mhz[0] + 0.5])
    middle = (frequency_mhz[1:] + frequency_mhz[:-1]) / 2
    return np.array([2 * frequency_mhz[0] - middle[0], *middle, 2 * frequency_mhz[-1] - middle[-1]])
