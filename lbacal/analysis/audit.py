"""`lbacal.audit`: what is wrong with a station, in seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from lbacal.pages.audit import draw_page, draw_station
from lbacal.pages.report import list_origin
from lbacal_core.audit.audit import AuditReport
from lbacal_core.audit.audit import audit as audit_spectra
from lbacal_core.audit.verdict import WRONG, Line
from lbacal_core.readers.correlator import is_correlator_file
from lbacal_core.readers.statistics import is_statistics
from lbacal_core.spectra.spectra import Spectra, read_spectra

COLUMNS = ("verdict", "check", "station", "what was found")


@dataclass(frozen=True, repr=False, kw_only=True)
class Audit(Result):
    """The report of an audit of stations, a line a question."""

    report: AuditReport

    @property
    def wrong(self) -> list[Line]:
        """The lines that say that something is wrong."""
        return [line for line in self.report.lines if line.verdict == WRONG]


def audit(
    data: Spectra | str | Path,
    instrument: Described,
    sky: str | None = None,
    antenna: str | None = None,
    average: Any = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Audit:
    """Check stations: dead, deaf or outlying paths, exchanged dipoles, cables, clock, arms, place, unit.

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
    core = core_of(instrument)
    tell(f"audit {len(spectra)} spectra")
    report = audit_spectra(spectra, core, sky, antenna)
    wrong = sum(line.verdict == WRONG for line in report.lines)
    rows = [(line.verdict, line.check, line.station, f"{line.sentence}{_odds(line)}") for line in report.lines]
    models = {"instrument": core.name, "sky": sky or "of the instrument", "antenna": antenna or "of the instrument"}
    origin = [*list_origin(name, time_unix=spectra.time_unix), *models.items()]
    return Audit(
        title=f"{name}: {f'{wrong} wrong' if wrong else 'nothing wrong'}",
        rows=[COLUMNS, *rows],
        words=len(COLUMNS),
        notes=[
            f"{station.name}: {station.antennas.size} antennas, {station.hours:.2f} h of sidereal time"
            for station in report.stations
        ],
        charts=lambda: chain.from_iterable(map(draw_station, report.stations)),
        columns=len(core.dipoles),
        as_table=partial(_list_lines, report.lines),
        as_dict=report.as_dict,
        page=partial(draw_page, report, origin),
        report=report,
    )


def _list_lines(lines: Sequence[Line]) -> QTable:
    """A row a line: its value and sigma are in its unit, and numbers that it does not have are NaN."""
    texts = {
        "verdict": [one.verdict for one in lines],
        "check": [one.check for one in lines],
        "station": [one.station for one in lines],
        "antennas": [" ".join(map(str, one.antennas)) for one in lines],
        "dipole": [one.dipole or "" for one in lines],
    }
    numbers = {name: [getattr(one, name) for one in lines] for name in ("value", "sigma", "log_odds")}
    words = {"unit": [one.unit for one in lines], "sentence": [one.sentence for one in lines]}
    return QTable(
        {name: np.array(column, dtype=str) for name, column in texts.items()}
        | {name: np.array(column, dtype=float) for name, column in numbers.items()}
        | {name: np.array(column, dtype=str) for name, column in words.items()}
    )


def _odds(line: Line) -> str:
    return "" if line.log_odds is None else f" (ln odds {line.log_odds:+.0f})"


def _read(data: Path, instrument: Described, average: Any, tell: Callable[[str], None]) -> Spectra:
    """Spectra from their file, or averaged from another format to the channels of the instrument."""
    import h5py

    is_hdf5 = data.is_file() and data.suffix != ".uvh5" and (data.suffix in (".h5", ".hdf5") or h5py.is_hdf5(data))
    if is_hdf5 and not is_statistics(data) and not is_correlator_file(data):
        return read_spectra(data)
    return import_data(data, average, instrument, tell=tell)
