"""CSV tables of many integrations: one row an integration of one path (docs/how-to/import-other-data.md)."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import guess_widths
from lbacal_core.readers.source import Integrations, Source

KEYS = ("time", "antenna", "dipole")
FACTS = ("station", "duration_s", "event_id", "flag")
COVARIATE = "env/"
Row = dict[str, str]


def is_table_of_rows(path: Path) -> bool:
    """Whether a CSV file begins with the column `time`."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return next(_lines(file), "").split(",")[0].strip() == "time"
    except (OSError, UnicodeDecodeError):
        return False


def open_table(path: Path, station: str) -> Source:
    """Open a table with the columns `time`, `antenna`, `dipole`, one a frequency (its number, MHz), and facts.

    Parameters
    ----------
    station
        Name of the station where the table has no column of this name.
    """
    frequency_of = _read_header(path)
    names = sorted(frequency_of, key=lambda name: frequency_of[name])
    frequency = np.array([frequency_of[name] for name in names])
    paths: dict[tuple[str, int, str], int] = {}
    for row in _rows(path):
        paths.setdefault(_path_of(row, station, path), len(paths))
    if not paths:
        raise BadInputError(str(path), "at least one row", "none")
    keys = list(paths)
    return Source(
        name=path.name,
        frequency_mhz=frequency,
        width_mhz=guess_widths(frequency),
        station=np.array([one for one, _, _ in keys]),
        antenna=np.array([number for _, number, _ in keys], dtype=np.int64),
        dipole=np.array([letter for *_, letter in keys]),
        read=lambda: _read(path, names, paths, station),
    )


def _lines(file: Any) -> Iterator[str]:
    return (line for line in file if line.strip() and not line.startswith("#"))


def _rows(path: Path) -> Iterator[Row]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield from csv.DictReader(_lines(file), skipinitialspace=True)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnreadableFileError(f"{path}: expected a CSV table ({error})") from error


def _read_header(path: Path) -> dict[str, float]:
    """The columns that are frequencies, MHz."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        header = [name.strip() for name in next(_lines(file), "").split(",")]
    missing = [name for name in KEYS if name not in header]
    if missing:
        raise BadInputError(f"{path}: line 1", f"the columns {', '.join(KEYS)}", f"no {', '.join(missing)}")
    if len(set(header)) < len(header) or "" in header:
        raise BadInputError(f"{path}: line 1", "a name for every column, each once", ", ".join(header)[:80])
    frequencies = {
        name: _number(name, f"{path}: column {name!r}", "a frequency in MHz, or one of the known names")
        for name in header
        if name not in (*KEYS, *FACTS) and not name.startswith(COVARIATE)
    }
    if not frequencies:
        raise BadInputError(f"{path}: line 1", "at least one column that is a frequency in MHz", "none")
    return frequencies


def _path_of(row: Row, station: str, path: Path) -> tuple[str, int, str]:
    number, letter = (row.get("antenna") or "").strip(), (row.get("dipole") or "").strip()
    if not number.isdecimal():
        raise BadInputError(f"{path}: antenna", "a number >= 0 in every row", repr(number))
    return (row.get("station") or "").strip() or station, int(number), letter


def _read(path: Path, names: list[str], paths: dict[tuple[str, int, str], int], station: str) -> Iterator[Integrations]:
    latest = -np.inf
    for text, rows in groupby(_rows(path), key=lambda row: (row["time"] or "").strip()):
        together = list(rows)
        time = parse_time(text, path)
        if time <= latest:
            raise BadInputError(f"{path}: time", "rows in order of time", f"{text} after a later or equal one")
        latest = time
        power = np.full((1, len(paths), len(names)), np.nan)
        for row in together:
            at = paths[_path_of(row, station, path)]
            power[0, at] = [_number(row[name], f"{path}: {text}, {name} MHz", "a number") for name in names]
        first = together[0]
        length = _number(first.get("duration_s") or "1", f"{path}: {text}, duration_s", "a number of seconds > 0")
        covariates = {name.removeprefix(COVARIATE): name for name in first if name and name.startswith(COVARIATE)}
        yield Integrations(
            np.array([time]),
            np.array([length]),
            power,
            event_id=np.array([(first.get("event_id") or "").strip()]),
            flag=np.array([(first.get("flag") or "").strip()]),
            environment={
                name: np.array([_number(first[column], f"{path}: {text}, {column}", "a number")])
                for name, column in covariates.items()
            },
        )


def _number(text: str | None, place: str, expected: str) -> float:
    """A number; NaN for an empty cell."""
    if text is None or not text.strip():
        return float("nan")
    try:
        return float(text)
    except ValueError as error:
        raise BadInputError(place, expected, repr(text[:40])) from error


def parse_time(text: str, path: Path) -> float:
    """Seconds since 1970 of an ISO 8601 instant, UTC unless it says otherwise; or of such a number."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError as error:
        raise BadInputError(f"{path}: time", "an ISO 8601 instant", repr(text)) from error
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
