"""The page of an audit: its lines as a table, every path against the others, and what the station saw of the sky."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.report import DIPOLE_COLOURS, GREY, embed, fill_report
from lbacal_core.audit.antennas import compare_paths
from lbacal_core.audit.audit import AuditReport
from lbacal_core.audit.station import AuditedStation

SHORTEST_HOURS = 0.5
LARGEST_DB = 3.0


def draw_page(report: AuditReport, source: str) -> str:
    """The report as HTML."""
    stations = [
        {"name": station.name, "figure": embed(_draw_station(station)), "hours": station.hours}
        for station in report.stations
    ]
    lines = [line.as_dict() for line in report.lines]
    return fill_report("audit.html", source=source, healthy=report.is_healthy, lines=lines, stations=stations)


def _draw_station(station: AuditedStation) -> Figure:
    """Departure of every path from the median of its polarisation and cable name, and band power against LST."""
    has_sky = station.hours >= SHORTEST_HOURS
    figure = Figure(figsize=(10, 7.5 if has_sky else 4.5), layout="constrained")
    axes: Any = figure.subplots(2 if has_sky else 1, 2, squeeze=False, sharey="row")
    power = station.before_cable()
    comparison = compare_paths(station)
    departure = 10 / np.log(10) * (comparison.level[..., None] + comparison.profile)
    edges = _edges(station.frequency_mhz)
    for column, dipole in enumerate(station.dipoles):
        image = axes[0, column].pcolormesh(
            edges, np.arange(station.antennas.size + 1) - 0.5, departure[:, column],
            cmap="RdBu_r", vmin=-LARGEST_DB, vmax=LARGEST_DB,
        )  # fmt: skip
        axes[0, column].set(xlabel="frequency (MHz)", title=f"{station.name} {dipole}")
        ticks = np.unique(np.linspace(0, station.antennas.size - 1, 13).astype(int))
        axes[0, column].set_yticks(ticks, [str(a) for a in station.antennas[ticks]])
        if has_sky:
            band = 10 / np.log(10) * (np.nanmean(power[:, column], axis=-1))
            band = band - np.nanmedian(band, axis=-1, keepdims=True)
            order = np.argsort(station.lst_hours)
            axes[1, column].plot(station.lst_hours[order], band[:, order].T, color=GREY, lw=0.4, alpha=0.5)
            median = np.nanmedian(band, axis=0)[order]
            axes[1, column].plot(station.lst_hours[order], median, ".-", color=DIPOLE_COLOURS[dipole], label="median")
            axes[1, column].set(xlabel="local sidereal time (h)", xlim=(0, 24))
            axes[1, column].legend(frameon=False)
    axes[0, 0].set_ylabel("antenna")
    if has_sky:
        axes[1, 0].set_ylabel("power of the band over its median (dB)")
    figure.colorbar(image, ax=axes[0], label="power over the median of the cable name (dB)")
    return figure


def _edges(frequency_mhz: np.ndarray) -> np.ndarray:
    if frequency_mhz.size == 1:
        return np.array([frequency_mhz[0] - 0.5, frequency_mhz[0] + 0.5])
    middle = (frequency_mhz[1:] + frequency_mhz[:-1]) / 2
    return np.array([2 * frequency_mhz[0] - middle[0], *middle, 2 * frequency_mhz[-1] - middle[-1]])
