"""`lbacal.audit`: what is wrong with a station, in seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable

from lbacal.analysis.data import import_data
from lbacal.analysis.instrument import Described, core_of
from lbacal.analysis.result import Result
from lbacal.files import path_of
from lbacal.pages.chart import BAND, IMAGE, INK, LINE, OF_DIPOLE, Chart, Series
from lbacal.pages.curves import FREQUENCY
from lbacal.pages.report import Origin, fill_report, list_origin
from lbacal_core.audit.antennas import DECIBEL, compare_paths
from lbacal_core.audit.audit import AuditReport
from lbacal_core.audit.audit import audit as audit_spectra
from lbacal_core.audit.sky_match import SHORTEST_HOURS
from lbacal_core.audit.station import AuditedStation
from lbacal_core.audit.verdict import UNDECIDED, Line
from lbacal_core.readers.correlator import is_correlator_file
from lbacal_core.readers.statistics import is_statistics
from lbacal_core.spectra.spectra import Spectra, read_spectra

COLUMNS = ("verdict", "check", "station", "what was found")
LARGEST_DB = 3.0
FOR_AXIS, ROW = 70, 16


@dataclass(frozen=True, repr=False, kw_only=True)
class Audit(Result):
    """The report of an audit of stations, a line a question."""

    report: AuditReport

    @property
    def wrong(self) -> list[Line]:
        """The lines that say that something is wrong."""
        return self.report.wrong


def audit(
    data: Spectra | str | Path,
    instrument: Described,
    sky: str | None = None,
    antenna: str | None = None,
    average: Any = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Audit:
    """Check stations: dead, insensitive or outlying paths, exchanged dipoles, cables, clock, arms, place, unit.

    Parameters
    ----------
    data
        Spectra, their file, or data in any format of `lbacal.import_data`.
    sky, antenna
        Models of what a working station sees, by name or file; those that the instrument names unless given.
    average
        Time that one spectrum averages, of data that are no spectra yet, s or a Quantity; 900 s unless given.
    tell
        Called with a sentence before each step.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=60, antennas=6)
    >>> lbacal.audit(spectra, "lofar-superterp").wrong
    []
    """
    spectra = data if isinstance(data, Spectra) else _read(path_of("data", data), instrument, average, tell)
    name = spectra.origin if isinstance(data, Spectra) else Path(data).name
    core = core_of(instrument).on_channels(spectra.frequency_mhz)
    tell(f"audit {len(spectra)} spectra")
    report = audit_spectra(spectra, core, sky, antenna)
    doubts = sorted({one.check for one in report.lines if one.verdict == UNDECIDED and (one.log_odds or 0.0) > 0})
    found = f"{len(report.wrong)} wrong" if report.wrong else "nothing wrong"
    rows = [(line.verdict, line.check, line.station, f"{line.sentence}{_odds(line)}") for line in report.lines]
    models = {"instrument": core.name, "sky": sky or "of the instrument", "antenna": antenna or "of the instrument"}
    origin = [*list_origin(name, time_unix=spectra.time_unix), *models.items()]
    return Audit(
        title=f"{name}: {found}{' for certain, but doubtful: ' + ', '.join(doubts) if doubts else ''}",
        rows=[COLUMNS, *rows],
        words=len(COLUMNS),
        notes=[
            f"{station.name}: {station.antennas.size} antennas, {station.hours:.2f} h of sidereal time"
            for station in report.stations
        ],
        charts=lambda: chain.from_iterable(map(_draw_station, report.stations)),
        columns=len(core.dipoles),
        as_table=partial(_list_lines, report.lines),
        as_dict=report.as_dict,
        page=partial(_draw_page, report, origin),
        report=report,
    )


def _list_lines(lines: Sequence[Line]) -> QTable:
    """A row a line: its value and sigma are in its unit, and numbers that it does not have are NaN."""
    told = [{**vars(one), "antennas": " ".join(map(str, one.antennas)), "dipole": one.dipole or ""} for one in lines]
    texts, numbers = ("verdict", "check", "station", "antennas", "dipole"), ("value", "sigma", "log_odds")
    kinds = {**dict.fromkeys(texts, str), **dict.fromkeys(numbers, float), "unit": str, "sentence": str}
    return QTable({name: np.array([one[name] for one in told], dtype=kind) for name, kind in kinds.items()})


def _odds(line: Line) -> str:
    return "" if line.log_odds is None else f" (ln odds {line.log_odds:+.0f})"


def _read(data: Path, instrument: Described, average: Any, tell: Callable[[str], None]) -> Spectra:
    """Spectra from their file, or averaged from another format to the channels of the instrument."""
    import h5py

    is_hdf5 = data.is_file() and data.suffix != ".uvh5" and (data.suffix in (".h5", ".hdf5") or h5py.is_hdf5(data))
    if is_hdf5 and not is_statistics(data) and not is_correlator_file(data):
        return read_spectra(data)
    return import_data(data, average, instrument, tell=tell)


# The page: its lines as a table, every path against the others, and what the station saw of the sky.


def _draw_page(report: AuditReport, origin: Origin) -> str:
    """Draw the report as HTML."""
    stations = [
        {"name": station.name, "charts": list(_draw_station(station)), "hours": station.hours}
        for station in report.stations
    ]
    lines = [line.as_dict() for line in report.lines]
    return fill_report("audit.html", healthy=report.is_healthy, lines=lines, stations=stations, made_from=origin)


def _draw_station(station: AuditedStation) -> Iterator[Chart]:
    """Departure of every path from the median of its polarisation and cable name, and band power against LST."""
    compared = compare_paths(station)
    departure = DECIBEL * (compared.level[..., None] + compared.profile)
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
    band = DECIBEL * np.nanmean(station.before_cable()[:, column], axis=-1)
    band = (band - np.nanmedian(band, axis=-1, keepdims=True))[:, order]
    lst, colour = station.lst_hours[order], OF_DIPOLE.get(dipole, INK)
    low, high = np.fmin.reduce(band), np.fmax.reduce(band)
    series = [
        Series(BAND, lst, low=low, high=high, name="all paths", colour=colour),
        Series(LINE, lst, np.nanmedian(band, axis=0), name="median", colour=colour),
    ]
    title, label = f"{station.name} {dipole}: power of the band", "power over its median (dB)"
    return Chart(title, "local sidereal time (h)", label, series, x_limits=(0.0, 24.0))
