"""The spectra that a command or a verb is given: files and folders, and which of their events and stations to use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lbacal.instants import format_instant, format_time, parse_instant
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError, offer_name
from lbacal_core.foreign import write_instant
from lbacal_core.hdf5 import HDF5_FAILURES
from lbacal_core.spectra.spectra import FORMAT, Spectra, join_spectra, read_spectra

SUFFIXES = (".h5", ".hdf5")
MICRO = 1e-6


@dataclass(frozen=True)
class Selection:
    """Which spectra to use: events from `since` on and before `until`, of some stations; None or empty for all."""

    since: Instant | None = None
    until: Instant | None = None
    stations: tuple[str, ...] = ()

    def apply(self, spectra: Spectra) -> Spectra:
        """Select the chosen spectra."""
        chosen = np.ones(len(spectra), dtype=bool)
        if self.since is not None:
            chosen &= spectra.time_unix >= MICRO * self.since
        if self.until is not None:
            chosen &= spectra.time_unix < MICRO * self.until
        if self.stations:
            chosen &= np.isin(spectra.station, self.stations)
        return spectra if np.all(chosen) else spectra.select(chosen)

    @property
    def options(self) -> str:
        """As it would be written on the command line, with a space in front; empty for everything."""
        parts = [f" --since {format_instant(self.since)}"] if self.since is not None else []
        parts += [f" --until {format_instant(self.until)}"] if self.until is not None else []
        return "".join([*parts, *(f" --station {name}" for name in self.stations)])


def parse_selection(
    since: Any, until: Any, year: int | None, stations: Sequence[str] | None, prefix: str = "--"
) -> Selection:
    """Read the options of a selection, which a command writes with a prefix; instants are those of `format_time`."""
    if year is not None and (since is not None or until is not None):
        raise BadInputError(f"{prefix}year", f"either {prefix}year or {prefix}since and {prefix}until", "both")
    if year is not None:
        since, until = f"{year:04d}-01-01", f"{year + 1:04d}-01-01"
    since, until = (None if end is None else format_time(end) for end in (since, until))
    first, last = (
        None if text is None else parse_instant(option, text)
        for option, text in ((f"{prefix}since", since), (f"{prefix}until", until))
    )
    if first is not None and last is not None and first >= last:
        raise BadInputError(f"{prefix}since, {prefix}until", "an end after the beginning", f"{since} to {until}")
    return Selection(first, last, tuple(dict.fromkeys(stations or ())))


def find_spectra_files(paths: Sequence[Path]) -> list[Path]:
    """The spectra files that are named, and those in the folders that are named, however deep, each once."""
    found: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            inside = [file for file in sorted(path.rglob("*")) if file.suffix in SUFFIXES and _is_spectra(file)]
            if not inside:
                raise BadInputError(
                    f"{path}",
                    f"spectra files ({FORMAT}; {', '.join(SUFFIXES)})",
                    "none in this folder (lbacal import makes them of other formats)",
                )
            found |= dict.fromkeys(file.resolve() for file in inside)
        else:
            found[path.resolve() if path.exists() else path] = None
    return list(found)


def _is_spectra(file: Path) -> bool:
    """Whether a file of a folder says that it is a spectra file; traces and other HDF5 may lie beside."""
    try:
        with h5py.File(file, "r") as opened:
            return opened.attrs.get("format") in (FORMAT, FORMAT.encode())
    except HDF5_FAILURES:
        return False


def read_selected(
    files: Sequence[Path], selection: Selection, now_unix: float, tell: Callable[[str], None] = lambda _: None
) -> Spectra:
    """Read files one by one, keep what is chosen, and join it."""
    kept, seen = [], []
    for file in files:
        tell(f"read {file.name}")
        whole = read_spectra(file, now_unix)
        if whole.left_out:
            words = ", ".join(f"{count} {flag}" for flag, count in whole.left_out.items())
            tell(f"{file.name}: {sum(whole.left_out.values())} spectra are flagged ({words}), left out")
        if len(whole):
            seen.append((*whole.span_unix, set(whole.station.tolist())))
        chosen = selection.apply(whole)
        if len(chosen) or len(files) == 1:
            kept.append(chosen)
    if seen and not any(len(one) for one in kept):
        begins, ends, stations = zip(*seen, strict=True)
        first, last = (write_instant(at)[:10] for at in (min(begins), max(ends)))
        names = sorted(set().union(*stations))
        unknown = [offer_name(name, names) for name in selection.stations if name not in names]
        found = f"none{f' of {unknown[0]}' if unknown else ''}: there are {first} to {last} of {', '.join(names)}"
        raise BadInputError(f"spectra{selection.options}", "some", found)
    return join_spectra(kept)
