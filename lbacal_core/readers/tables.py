"""CSV tables of many integrations: one row an integration of one path (docs/how-to/import-other-data.md)."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError, reading, require_parts
from lbacal_core.foreign import parse_instant, read_npz, read_text
from lbacal_core.grids import Floats, guess_widths
from lbacal_core.readers.source import Integrations, Source

KEYS = ("time", "antenna", "dipole")
FACTS = ("station", "duration_s", "event_id", "flag")
COVARIATE = "env/"
Row = dict[str, str]


def open_file(path: Path, station: str) -> Source:
    """Open a table of many integrations, or a table or archive of one."""
    return open_table(path, station) if is_table_of_rows(path) else open_folder([path], station)


def is_table_of_rows(path: Path) -> bool:
    """Whether a CSV file begins with the column `time`."""
    if path.suffix != ".csv":
        return False
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
    broken = reading(f"{path}: expected a CSV table", OSError, UnicodeDecodeError, csv.Error)
    with broken, path.open(encoding="utf-8-sig", newline="") as file:
        yield from csv.DictReader(_lines(file), skipinitialspace=True)


def _read_header(path: Path) -> dict[str, float]:
    """The columns that are frequencies, MHz."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        header = [name.strip() for name in next(_lines(file), "").split(",")]
    require_parts(f"{path}: line 1", "columns", KEYS, header)
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
        time = parse_instant(text, f"{path}: time")
        if time <= latest:
            raise BadInputError(f"{path}: time", "rows in order of time", f"{text} after a later or equal one")
        latest = time
        power = np.full((len(paths), len(names)), np.nan)
        for row in together:
            at = paths[_path_of(row, station, path)]
            power[at] = [_number(row[name], f"{path}: {text}, {name} MHz") for name in names]
        yield _integrate(time, power, together[0], f"{path}: {text}, ")


def _integrate(time_unix: float, power: Floats, facts: Mapping[str, str], place: str) -> Integrations:
    """One integration, power of shape (path, freq), with what is told of it as texts."""
    return Integrations(
        np.array([time_unix]),
        np.array([_number(facts.get("duration_s") or "1", f"{place}duration_s", "a number of seconds > 0")]),
        power[None],
        event_id=np.array([(facts.get("event_id") or "").strip()]),
        flag=np.array([(facts.get("flag") or "").strip()]),
        environment={
            name.removeprefix(COVARIATE): np.array([_number(text, f"{place}{name}")])
            for name, text in facts.items()
            if name and name.startswith(COVARIATE)
        },
    )


def _number(text: str | None, place: str, expected: str = "a number") -> float:
    """A number; NaN for an empty cell."""
    if text is None or not text.strip():
        return float("nan")
    try:
        return float(text)
    except ValueError as error:
        raise BadInputError(place, expected, repr(text[:40])) from error


# Folders of one file an integration: CSV tables or NumPy archives (docs/how-to/import-other-data.md).

SUFFIXES = (".csv", ".npz")


def open_folder(files: Sequence[Path], station: str) -> Source:
    """Open files of one integration each; every file has the same channels and paths, the first decides which.

    A CSV file has a column `frequency_mhz` and one column a path (`17X`), and a line `# time: 2014-05-01T03:04:05Z`; a
    NumPy archive has `frequency_mhz` (freq,), `power` (path, freq), `antenna` (path,), `dipole` (path,) and
    `time_unix`, and `duration_s` if it is not 1 s. Both may have `event_id`, `flag` and covariates `env/...`.
    """
    first = _read_file(files[0])
    frequency_mhz, paths = first.frequency_mhz, first.paths
    instants = [first.time_unix]
    for file in files[1:]:
        content = _read_file(file)
        if content.paths != paths or not np.array_equal(content.frequency_mhz, frequency_mhz):
            raise BadInputError(str(file), f"the channels and paths of {files[0].name}", "others")
        instants.append(content.time_unix)
    in_order = [files[k] for k in np.argsort(instants, kind="stable")]
    return Source(
        name=files[0].parent.name or str(files[0]),
        frequency_mhz=frequency_mhz,
        width_mhz=guess_widths(frequency_mhz),
        station=np.full(len(paths), station),
        antenna=np.array([antenna for antenna, _ in paths], dtype=np.int64),
        dipole=np.array([dipole for _, dipole in paths]),
        read=lambda: _read_folder(in_order),
    )


def _read_folder(files: Sequence[Path]) -> Iterator[Integrations]:
    for file in files:
        content = _read_file(file)
        yield _integrate(content.time_unix, content.power, content.facts, f"{file}: ")


@dataclass(frozen=True)
class _Content:
    """One file: channels, paths, middle of the integration, power (path, freq), and its facts as texts."""

    frequency_mhz: Floats
    paths: list[tuple[int, str]]
    time_unix: float
    power: Floats
    facts: dict[str, str]


def _read_file(path: Path) -> _Content:
    return _read_archive(path) if path.suffix == ".npz" else _read_table(path)


def _read_table(path: Path) -> _Content:
    lines = read_text(path).splitlines()
    told = [line.lstrip("#").partition(":") for line in lines if line.startswith("#") and ":" in line]
    facts = {name.strip().lower(): value.strip() for name, _, value in told}
    rows = list(csv.reader(line for line in lines if line and not line.startswith("#")))
    if len(rows) < 2 or rows[0][0].strip() != "frequency_mhz":
        raise BadInputError(
            f"{path}: line 1",
            "frequency_mhz and one column a path, or time,antenna,dipole and one column a frequency",
            ",".join(rows[0][:3]) if rows else "nothing",
        )
    paths = [_parse_path(name.strip(), path) for name in rows[0][1:]]
    try:
        values = np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise BadInputError(str(path), "numbers in every column", str(error)) from error
    if values.ndim != 2 or values.shape[1] != len(paths) + 1:
        raise BadInputError(str(path), f"{len(paths) + 1} columns in every row", "fewer or more")
    if "time" not in facts:
        raise BadInputError(str(path), "a line '# time: 2014-05-01T03:04:05Z'", "none")
    return _Content(values[:, 0], paths, parse_instant(facts["time"], f"{path}: time"), values[:, 1:].T, facts)


def _read_archive(path: Path) -> _Content:
    needed = ("frequency_mhz", "power", "antenna", "dipole", "time_unix")
    content = read_npz(path, needed, "one integration")
    try:
        paths = [(int(a), str(d)) for a, d in zip(content["antenna"], content["dipole"], strict=True)]
        power, frequency = (np.asarray(content[name], dtype=float) for name in ("power", "frequency_mhz"))
        time_unix = float(content["time_unix"])
    except (ValueError, TypeError) as error:
        raise BadInputError(str(path), "numbers, and one antenna and dipole a path", str(error)[:80]) from error
    if power.shape != (len(paths), frequency.size):
        raise BadInputError(f"{path}: power", f"shape {(len(paths), frequency.size)} (path, freq)", f"{power.shape}")
    facts = {name: str(values) for name, values in content.items() if name not in needed and values.ndim == 0}
    return _Content(frequency, paths, time_unix, power, facts)


def _parse_path(name: str, path: Path) -> tuple[int, str]:
    found = re.fullmatch(r"(\d+)([A-Za-z][A-Za-z0-9_+-]{0,7})", name, re.ASCII)
    if found is None:
        raise BadInputError(f"{path}: column {name!r}", "an antenna and a dipole, such as 17X", repr(name))
    return int(found[1]), found[2]
