"""The page of an audit: its lines as a table, every path against the others, and what the station saw of the sky."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lbacal.pages.chart import BAND, IMAGE, INK, LINE, OF_DIPOLE, Chart, Series
from lbacal.pages.curves import FREQUENCY
from lbacal.pages.report import Origin, fill_report
from lbacal_core.audit.antennas import compare_paths
from lbacal_core.audit.audit import AuditReport
from lbacal_core.audit.station import AuditedStation

SHORTEST_HOURS = 0.5
LARGEST_DB = 3.0
DECIBELS = 10 / np.log(10)
FOR_AXIS, ROW = 70, 16


def draw_page(report: AuditReport, origin: Origin) -> str:
    """Draw the report as HTML."""
    stations = [
        {"name": station.name, "charts": list(draw_station(station)), "hours": station.hours}
        for station in report.stations
    ]
    lines = [line.as_dict() for line in report.lines]
    return fill_report(
        "audit.html",
        source=dict(origin)["file"],
        healthy=report.is_healthy,
        lines=lines,
        stations=stations,
        made_from=origin,
    )


def draw_station(station: AuditedStation) -> Iterator[Chart]:
    """Departure of every path from the median of its polarisation and cable name, and band power against LST."""
    compared = compare_paths(station)
    departure = DECIBELS * (compared.level[..., None] + compared.profile)
    rows, mhz = [str(antenna) for antenna in station.antennas], station.frequency_mhz
    step = np.median(np.diff(mhz)) if mhz.size > 1 else 1.0
    extent = (mhz[0] - step / 2, mhz[-1] + step / 2), (len(rows) - 0.5, -0.5)
    for column, dipole in enumerate(station.dipoles):
        image = Series(IMAGE, *extent, name="dB", image=departure[::-1, column], limit=LARGEST_DB)
        title = f"{station.name} {dipole}: power over the median of the cable name"
        yield Chart(
            title, FREQUENCY, "antenna", [image], x_limits=extent[0], rows=rows, height=FOR_AXIS + ROW * len(rows)
        )
    if station.hours >= SHORTEST_HOURS:
        yield from (_draw_sky(station, column) for column in range(len(station.dipoles)))


def _draw_sky(station: AuditedStation, column: int) -> Chart:
    """Band power of one dipole against LST, the median of its paths and their range."""
    dipole, order = station.dipoles[column], np.argsort(station.lst_hours)
    band = DECIBELS * np.nanmean(station.before_cable()[:, column], axis=-1)
    band = (band - np.nanmedian(band, axis=-1, keepdims=True))[:, order]
    lst, colour = station.lst_hours[order], OF_DIPOLE.get(dipole, INK)
    low, high = np.fmin.reduce(band), np.fmax.reduce(band)
    series = [
        Series(BAND, lst, low=low, high=high, name="all paths", colour=colour),
        Series(LINE, lst, np.nanmedian(band, axis=0), name="median", colour=colour),
    ]
    title, label = f"{station.name} {dipole}: power of the band", "power over its median (dB)"
    return Chart(title, "local sidereal time (h)", label, series, x_limits=(0.0, 24.0))
