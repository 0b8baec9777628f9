"""Background spectra: what one antenna's dipole measured in one event, and their file (docs/formats/spectra.md)."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import IO, Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core import hdf5
from lbacal_core.errors import BadInputError, UnreadableFileError, reading
from lbacal_core.foreign import write_instant
from lbacal_core.grids import DAY_S, Floats, guess_widths, require_channels, require_same_grid
from lbacal_core.instrument.antennas import EXPECTED, are_dipole_names
from lbacal_core.provenance import hash_arrays, hash_content

FORMAT = "lbacal-spectra-1"
EARLIEST_UNIX = datetime(2009, 1, 1, tzinfo=UTC).timestamp()
FAR_UNIX = 1e11
"""An instant beyond this, in the year 5138, is told as a number, s UTC."""
NO_SPECTRA = "expected a spectra file (HDF5), found something unreadable"
BLOCK_S = 1024 / 200e6
"""Length of a block of LOFAR's transient buffer (1024 samples at 200 MHz), the unit of `blocks` in a spectra file."""
WIDEST_OF_SPACING = 10
"""Channels of filter banks overlap; a width of so many spacings is in another unit."""
MAX_COVARIATES = 16
"""Covariates of one event."""
_COVARIATE = re.compile(r"[a-z][a-z0-9_]{0,39}", re.ASCII)
POSSIBLE = {"temperature_c": (-90.0, 60.0), "rain_mm_h": (0.0, 2300.0)}
"""Least and most of a covariate anywhere on Earth, rounded outwards.

Air on the ground was -89.2 C at Vostok in 1983 and 56.7 C at Furnace Creek in 1913 (WMO, World Weather and Climate
Extremes Archive); 38 mm of rain fell in a minute at Barot in 1970 (WMO, Guide to Hydrological Practices).
"""

_COLUMNS = ("event_id", "time_unix", "station", "antenna", "dipole", "blocks")
_BY_ROW = (*_COLUMNS, "power")
_BY_ROW_AT_TIMES = ("duration_s", "flag")
"""Fields with an entry a row: those that all spectra have, and those that some have."""
_KEY = ("station", "antenna", "dipole", "event_id")
_KINDS = {
    "frequency_mhz": hdf5.NUMBERS,
    "power": hdf5.REALS,
    "event_id": hdf5.STRINGS,
    "time_unix": hdf5.FLOATS,
    "station": hdf5.STRINGS,
    "antenna": hdf5.INTEGERS,
    "dipole": hdf5.STRINGS,
    "blocks": hdf5.INTEGERS,
}
NO_POWER = 1e-6
"""Over the typical channel's power: no filter with a channel that anybody calibrates lets less pass."""
_ARM = "azimuth_deg_"
"""The attribute of a file that has the azimuth of an arm begins with this, and ends with the dipole."""
_OPTIONAL = {"width_mhz": hdf5.NUMBERS, "duration_s": hdf5.NUMBERS, "flag": hdf5.STRINGS}


Owner = tuple[str, int]
"""Station and antenna."""
Rows = NDArray[np.bool_]
Result = TypeVar("Result")


def span_of_record(now_unix: float) -> tuple[float, float]:
    """The first and last instant of which there may be a record, s UTC.

    From 2009 (LOFAR's first dumps are older) to a day ahead of `now_unix`.
    """
    return EARLIEST_UNIX, now_unix + DAY_S


@dataclass(frozen=True)
class Spectra:
    """N background spectra; row k is one (event, station, antenna, dipole).

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    power
        Shape (row, freq), mean |F(nu)|^2 / R_r, ADC^2/Ohm/MHz, one-sided, > 0.
    event_id, station, dipole
        Shape (row,), strings.
    time_unix
        Shape (row,), s UTC.
    antenna, blocks
        Shape (row,), integers; `blocks` counts the 1024-sample blocks averaged.
    resistance_ohm
        R_r, one constant that cancels in C.
    environment
        Covariates by name (`temperature_c`, `rain_mm_h`), shape (row,), NaN where unknown.
    width_mhz
        Widths of the channels, shape (freq,), MHz; None where the file has none: see `channel_widths`.
    duration_s
        What was averaged in each spectrum, shape (row,), s; None where only `blocks` counts it.
    flag
        Why a spectrum must not be used, shape (row,), empty where it may; None where nothing is flagged. A file keeps
        flagged spectra, and `read_spectra` leaves them out.
    left_out
        How many flagged spectra were left out when the file was read, by flag.
    arms_deg
        Azimuths of the arms by dipole, north through east, deg, where who recorded says so.
    """

    frequency_mhz: Floats
    power: Floats
    event_id: NDArray[np.str_]
    time_unix: Floats
    station: NDArray[np.str_]
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    blocks: NDArray[np.int64]
    resistance_ohm: float = 50.0
    environment: Mapping[str, Floats] = field(default_factory=dict)
    origin: str = "spectra"
    width_mhz: Floats | None = None
    duration_s: Floats | None = None
    flag: NDArray[np.str_] | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    arms_deg: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_channels(self.origin, self.frequency_mhz)
        rows = len(self.event_id)
        for name in _BY_ROW[1:]:
            if len(getattr(self, name)) != rows:
                raise BadInputError(
                    f"{self.origin}: {name}", f"{rows} rows as in event_id", f"{len(getattr(self, name))}"
                )
        if self.power.shape != (rows, self.frequency_mhz.size):
            raise BadInputError(f"{self.origin}: power", f"{self.frequency_mhz.size} channels", f"{self.power.shape}")
        if not (np.isfinite(self.resistance_ohm) and self.resistance_ohm > 0):
            raise BadInputError(f"{self.origin}: resistance_ohm", "Ohm > 0", f"{self.resistance_ohm}")
        is_flagged = False if self.flag is None else self.flag != ""
        is_good = np.all(np.isfinite(self.power) & (self.power > 0), axis=1) | is_flagged
        self._require("power", is_good, "finite power > 0")
        self._require("time_unix", np.isfinite(self.time_unix) & (self.time_unix > 0), "an instant (s UTC)")
        self._require("dipole", are_dipole_names(self.dipole), EXPECTED)
        self._require("antenna", self.antenna >= 0, "a number >= 0")
        self._require("blocks", self.blocks > 0, "a count > 0")
        self._require("event_id", self.event_id != "", "a name")
        self._require("station", self.station != "", "a name")
        if self.flag is not None and self.flag.shape != (rows,):
            raise BadInputError(f"{self.origin}: flag", f"{rows} texts, one a row", f"shape {self.flag.shape}")
        self._require_covariates(rows)
        self._require_widths_and_durations(rows)
        self._require_unique_keys()
        self._require_no_copies()

    def _require_widths_and_durations(self, rows: int) -> None:
        for name, values, size in (
            ("width_mhz", self.width_mhz, self.frequency_mhz.size),
            ("duration_s", self.duration_s, rows),
        ):
            if values is None:
                continue
            if values.shape != (size,):
                raise BadInputError(f"{self.origin}: {name}", f"{size} numbers", f"shape {values.shape}")
            bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
            if bad.size:
                raise BadInputError(
                    f"{self.origin}: {name}, entry {bad[0]}", "a finite number > 0", f"{values[bad[0]]}"
                )
        spacing = np.abs(np.diff(self.frequency_mhz)).max(initial=0.0)
        if self.width_mhz is not None and 0 < WIDEST_OF_SPACING * spacing < self.width_mhz.max():
            most = f"at most {WIDEST_OF_SPACING} spacings of channels, {WIDEST_OF_SPACING * spacing:g} MHz"
            raise BadInputError(f"{self.origin}: width_mhz", most, f"{self.width_mhz.max():g}")

    def _require_covariates(self, rows: int) -> None:
        known = np.zeros(rows, dtype=np.int64)
        for name, values in self.environment.items():
            if not _COVARIATE.fullmatch(name):
                raise BadInputError(f"{self.origin}: env", "names such as rain_mm_h (40 characters)", repr(name[:60]))
            if values.shape != (rows,):
                raise BadInputError(f"{self.origin}: env/{name}", f"{rows} numbers, one a row", f"{values.shape}")
            self._require(f"env/{name}", ~np.isinf(values), "a number, or NaN where unknown")
            known += np.isfinite(values)
        require_possible(self.origin, self.environment, self.event_id)
        if np.any(known > MAX_COVARIATES):
            row = int(np.argmax(known))
            raise BadInputError(
                f"{self.origin}: env, row {row}", f"at most {MAX_COVARIATES} covariates", f"{known[row]}"
            )

    def _require(self, name: str, is_good: NDArray[np.bool_], expected: str) -> None:
        bad = np.flatnonzero(~np.asarray(is_good))
        if bad.size == 0:
            return
        row = int(bad[0])
        values = self.environment[name.removeprefix("env/")] if name.startswith("env/") else getattr(self, name)
        found = repr(str(values[row])) if name in ("event_id", "station", "dipole") else f"{values[row]}"
        if name == "time_unix" and abs(values[row]) < FAR_UNIX:
            found = f"{write_instant(values[row])} ({found} s UTC)"
        if name == "power":
            channel = int(np.flatnonzero(~(np.isfinite(values[row]) & (values[row] > 0)))[0])
            found = f"{values[row, channel]} at {self.frequency_mhz[channel]:g} MHz"
        more = f" (and {bad.size - 1} more rows)" if bad.size > 1 else ""
        raise BadInputError(f"{self.origin}: {name}, row {row}", expected, f"{found}{more}")

    def _require_unique_keys(self) -> None:
        rising = np.sort(self._keys)
        repeated = rising[1:][rising[1:] == rising[:-1]]
        if repeated.size:
            row = int(np.flatnonzero(self._keys == repeated[0])[1])
            expected = "one spectrum per event, station, antenna and dipole"
            raise BadInputError(f"{self.origin}: row {row}", expected, f"{self.name_row(row)} again")

    def _require_no_copies(self) -> None:
        """Refuse a spectrum that stands under the names of two events: neither's noise is its own."""
        of_first = self.power[:, 0]
        if np.unique(of_first).size == len(self):
            return
        path = self._keys // self.key_codes["event_id"][0].size
        order = np.lexsort((path, self.time_unix, of_first))
        is_same = [np.diff(values[order]) == 0 for values in (path, self.time_unix, of_first)]
        for k in np.flatnonzero(np.all(is_same, axis=0)).tolist():
            one, other = order[k], order[k + 1]
            if np.array_equal(self.power[one], self.power[other]):
                found = f"{self.name_row(one)}, with its instant and power again as {self.event_id[other]}"
                raise BadInputError(f"{self.origin}: row {other}", "each spectrum once", found)

    def name_row(self, row: int) -> str:
        """Event, station, antenna and dipole of a row, in words."""
        return f"{self.event_id[row]}, {self.station[row]} antenna {self.antenna[row]} {self.dipole[row]}"

    def __repr__(self) -> str:
        """One line: how much of what, and from when to when."""
        nu, ends = self.frequency_mhz, np.sort(self.time_unix)[:: max(len(self) - 1, 1)].astype("datetime64[s]")
        return f"<Spectra: {len(self)}, {nu.size} channels {nu[0]:g}-{nu[-1]:g} MHz, {' to '.join(ends.astype(str))}>"

    def __len__(self) -> int:
        return len(self.event_id)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Spectra:
        """The spectra of some rows, given by their numbers, in that order, or by a mask of shape (row,)."""
        own = {one.name: getattr(self, one.name) for one in fields(Spectra)}
        chosen = {name: own[name][rows] for name in (*_BY_ROW, *_BY_ROW_AT_TIMES) if own[name] is not None}
        environment = {name: values[rows] for name, values in self.environment.items()}
        return Spectra(**own | chosen | {"environment": environment})

    def without_empty_channels(self) -> Spectra:
        """The spectra in the channels that hold power in any of them."""
        kept = holds_power(self.power)
        if kept.all() or not kept.any():
            return self
        return replace(self, **keep_channels(vars(self), kept))

    def without_flagged(self) -> Spectra:
        """The spectra that are not flagged; `left_out` counts the others."""
        if self.flag is None:
            return self
        flags, counts = np.unique(self.flag[self.flag != ""], return_counts=True)
        found = dict(zip(flags.tolist(), counts.tolist(), strict=True))
        return replace(self.select(self.flag == ""), flag=None, left_out=found)

    def channel_widths(self) -> Floats:
        """Widths of the channels, shape (freq,), MHz: as given, else 1 on a grid of whole MHz, else the spacing."""
        return self.width_mhz if self.width_mhz is not None else guess_widths(self.frequency_mhz)

    def require_past(self, now_unix: float) -> None:
        """Refuse spectra of instants beyond `span_of_record`."""
        first, last = span_of_record(now_unix)
        self._require("time_unix", self.time_unix >= first, "an instant of 2009 or later (s UTC)")
        limit = f"an instant not after {write_instant(last)}, a day ahead of now"
        self._require("time_unix", self.time_unix <= last, limit)

    @property
    def head(self) -> Spectra:
        """Spectra with these channels."""
        return self

    @cached_property
    def span_unix(self) -> tuple[float, float]:
        """Instants of the first and the last, s UTC."""
        return float(self.time_unix.min(initial=np.inf)), float(self.time_unix.max(initial=-np.inf))

    def each(self, function: Callable[[Spectra], Result]) -> Iterable[Result]:
        """Call a function with all of them at once."""
        return [function(self)]

    def read(self, station: str) -> Spectra:  # noqa: ARG002 - all are here
        """Read spectra with all of a station."""
        return self

    def change(self, function: Callable[[Spectra], Spectra]) -> Spectra:
        """Make other spectra of them."""
        return function(self)

    def digest(self, station: str | None = None, antenna: int | None = None, dipole: str | None = None) -> str:
        """Hash of every value that a fit sees, of all spectra or of a station's or path's; their order does not count.

        It is the hash of the sorted hashes of its quarters.
        """
        hashes = pick_hashes(self.quarter_hashes, station, antenna, dipole)
        return hash_window(self.frequency_mhz, self.resistance_ohm, self.width_mhz, hashes)

    @cached_property
    def quarter_hashes(self) -> Quarters:
        """The hash of what each path recorded in each quarter."""
        numbers, path_of = np.unique(self._keys // self.key_codes["event_id"][0].size, return_inverse=True)
        first = np.empty(numbers.size, dtype=np.int64)
        first[path_of] = np.arange(len(self))
        paths = [(str(self.station[k]), int(self.antenna[k]), str(self.dipole[k])) for k in first]
        columns = [self.event_id, self.time_unix, self.blocks, self.power]
        columns += [] if self.duration_s is None else [self.duration_s]
        return hash_quarters(paths, path_of, np.argsort(self._keys), self.time_unix, columns)

    @cached_property
    def key_codes(self) -> Mapping[str, tuple[NDArray[Any], NDArray[np.int64]]]:
        """For each column of the key what occurs in it, rising, and which of these each row has, shape (row,)."""
        names = {name: np.unique(getattr(self, name)) for name in _KEY}
        return {name: (found, np.searchsorted(found, getattr(self, name))) for name, found in names.items()}

    def is_of(self, owners: Container[Owner]) -> Rows:
        """Which spectra are of some antennas, shape (row,)."""
        (stations, station_at), (antennas, antenna_at) = self.key_codes["station"], self.key_codes["antenna"]
        is_it = [[(station, antenna) in owners for antenna in antennas.tolist()] for station in stations.tolist()]
        return np.asarray(is_it, dtype=bool).reshape(stations.size, antennas.size)[station_at, antenna_at]

    @cached_property
    def _keys(self) -> NDArray[np.int64]:
        """One number a row that puts rows in order of station, antenna, dipole and event, shape (row,)."""
        keys = np.zeros(len(self), dtype=np.int64)
        for names, codes in self.key_codes.values():
            keys = keys * names.size + codes
        return keys


def read_spectra(path: Path, now_unix: float | None = None) -> Spectra:
    """Read a spectra file without its flagged spectra; with `now_unix`, refuse spectra of the future."""
    if not path.is_file():
        raise UnreadableFileError(
            f"{path}: expected a spectra file, found {'a folder' if path.is_dir() else 'no file'}"
        )
    if path.stat().st_size == 0:
        raise UnreadableFileError(f"{path}: expected a spectra file (HDF5), found an empty file")
    is_other = f"{path}: {NO_SPECTRA}, where lbacal import may read it"
    with reading(is_other, *hdf5.HDF5_FAILURES), h5py.File(path, "r") as file:
        content = _read_open_file(file, path.name) | {"arms_deg": _read_arms(file, path.name)}
    if (kept := holds_power(content["power"])).any():
        content |= keep_channels(content, kept)
    spectra = Spectra(**content, origin=path.name).without_flagged()
    if len(spectra) == 0 and spectra.left_out:
        raise BadInputError(
            f"{path}: flag", "a spectrum that is not flagged", f"all {sum(spectra.left_out.values())} are"
        )
    if now_unix is not None:
        spectra.require_past(now_unix)
    return spectra


def holds_power(power: Floats) -> NDArray[np.bool_]:
    """Whether channels hold any power, shape (freq,).

    Parameters
    ----------
    power
        Shape (row, freq); NaN or 0 where a channel was not recorded.
    """
    most = np.fmax.reduce(power, axis=0, initial=0.0)
    least = np.fmin.reduce(power, axis=0, initial=0.0)  # what is negative is refused where spectra are made
    return np.asarray(np.maximum(most, -least) > NO_POWER * np.median(most - least))


def keep_channels(content: Mapping[str, Any], kept: NDArray[np.bool_]) -> dict[str, Any]:
    """The fields of `Spectra` that a selection of channels changes."""
    given = {name: content[name] for name in ("frequency_mhz", "width_mhz") if content.get(name) is not None}
    return {name: values[kept] for name, values in given.items()} | {"power": content["power"][:, kept]}


def read_columns(content: bytes, place: str, largest_bytes: int) -> dict[str, Any]:
    """Read the bytes of a spectra file into the fields of `Spectra`, which has not checked them yet; none is flagged.

    Parameters
    ----------
    place
        What the bytes are, for messages.
    largest_bytes
        The most that any column may take in memory.
    """
    with (
        reading(f"{place}: {NO_SPECTRA}", *hdf5.HDF5_FAILURES),
        h5py.File(h5py.h5f.open_file_image(content), "r") as file,
    ):
        columns = _read_open_file(file, place, largest_bytes)
    flagged = np.flatnonzero(columns.pop("flag", np.array([""])) != "")
    if flagged.size:
        raise BadInputError(
            f"{place}: flag, row {flagged[0]}", "no flagged spectra (lbacal ingest leaves them out)", "one"
        )
    return columns


def _read_open_file(file: h5py.File, place: str, largest_bytes: int | None = None) -> dict[str, Any]:
    """Everything in the file by the names of `Spectra`; types and shapes are settled before any data are read."""
    found_format = file.attrs.get("format", "none")
    if (
        not isinstance(found_format, str | bytes)
        or hdf5.read_text(found_format, f"{place}: attribute format") != FORMAT
    ):
        raise BadInputError(f"{place}: attribute format", FORMAT, repr(found_format))
    names = set(file)
    missing, unknown = sorted(set(_KINDS) - names), sorted(names - set(_KINDS) - set(_OPTIONAL) - {"env"})
    if missing or unknown:
        found = [f"{word} {_listed(some)}" for word, some in (("no", missing), ("unknown", unknown)) if some]
        raise BadInputError(place, f"the datasets {', '.join(_KINDS)} and the group env", "; ".join(found))
    kinds = _KINDS | {name: kind for name, kind in _OPTIONAL.items() if name in names}
    if "env" in names:
        if not hdf5.is_in_file(file, "env") or not isinstance(file["env"], h5py.Group):
            raise BadInputError(f"{place}: env", "a group in this file", "something else")
        kinds |= {f"env/{name}": hdf5.NUMBERS for name in file["env"]}
    datasets = {name: hdf5.open_dataset(file, name, kind, f"{place}: {name}") for name, kind in kinds.items()}
    _require_shapes(datasets, place)
    for name, dataset in datasets.items():
        if largest_bytes is not None and dataset.nbytes > largest_bytes:
            raise BadInputError(f"{place}: {name}", f"at most {largest_bytes} bytes", f"{dataset.nbytes}")
    values = {name: hdf5.read_values(datasets[name], kind, f"{place}: {name}") for name, kind in kinds.items()}
    return {
        **{name: values[name] for name in values if not name.startswith("env/")},
        "resistance_ohm": _resistance(file, place),
        "environment": {name.removeprefix("env/"): values[name] for name in values if name.startswith("env/")},
    }


def _require_shapes(datasets: Mapping[str, h5py.Dataset], place: str) -> None:
    """One row per entry of event_id, one channel per entry of frequency_mhz."""
    for name in ("event_id", "frequency_mhz"):
        if datasets[name].ndim != 1 or datasets[name].shape is None:
            raise BadInputError(f"{place}: {name}", "one dimension", f"shape {datasets[name].shape}")
    rows, channels = datasets["event_id"].shape[0], datasets["frequency_mhz"].shape[0]
    for name, dataset in datasets.items():
        if name == "power" and dataset.shape != (rows, channels):
            expected = f"{rows} rows as in event_id and {channels} channels as in frequency_mhz"
            raise BadInputError(f"{place}: power", expected, f"shape {dataset.shape}")
        if name == "width_mhz" and dataset.shape != (channels,):
            raise BadInputError(f"{place}: width_mhz", f"{channels} channels as in frequency_mhz", f"{dataset.shape}")
        if name not in ("power", "frequency_mhz", "width_mhz") and dataset.shape != (rows,):
            raise BadInputError(f"{place}: {name}", f"{rows} rows as in event_id", f"shape {dataset.shape}")


def _resistance(file: h5py.File, place: str) -> float:
    found = file.attrs.get("resistance_ohm", 50.0)
    values = np.unique(np.asarray(found))
    if values.size != 1 or values.dtype.kind not in "fiu":
        raise BadInputError(f"{place}: attribute resistance_ohm", "one number", f"{found}")
    return float(values[0])


def _read_arms(file: h5py.File, place: str) -> dict[str, float]:
    found = {name.removeprefix(_ARM): value for name, value in file.attrs.items() if name.startswith(_ARM)}
    for letter, value in found.items():
        if not (np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu" and np.isfinite(value)):
            raise BadInputError(f"{place}: attribute {_ARM}{letter}", "a number of degrees", str(value)[:40])
    return {letter: float(value) for letter, value in found.items()}


def name_event(begin_unix: float) -> str:
    """Event id from the UTC second in which an event or an interval begins: 20110719T110541."""
    return f"{datetime.fromtimestamp(int(begin_unix), UTC):%Y%m%dT%H%M%S}"


def lay_out_rows(rows: Sequence[Mapping[str, Any]], channels: int) -> dict[str, Any]:
    """The columns of `Spectra` from rows that hold a value of each under its name; power has so many `channels`."""
    columns: dict[str, Any] = {
        name: np.array([row[name] for row in rows], dtype=_KINDS[name].read_as) for name in _BY_ROW
    }
    return columns | {"power": columns["power"].reshape(len(rows), channels)}


def require_possible(place: str, environment: Mapping[str, Floats], names: NDArray[np.str_]) -> None:
    """Refuse covariates that nowhere on Earth has, such as a number that stands for an unknown one, or Kelvin.

    One such temperature decides the size of a cause that follows it. `names` tell whose they are, shape (row,).
    """
    for name, values in environment.items():
        low, high = POSSIBLE.get(name, (-np.inf, np.inf))
        bad = (values < low) | (values > high)
        if np.any(bad):
            expected = f"{low:g} to {high:g} (where it is not known write NaN, or leave it out"
            expected += "; from Kelvin subtract 273.15)" if name == "temperature_c" else ")"
            found = f"{values[bad][0]:g} in {_listed(np.unique(names[bad]).tolist())}"
            raise BadInputError(f"{place}: env/{name}", expected, found)


def _listed(names: list[str]) -> str:
    """Names for a sentence: in quotes where they are odd, and not thousands of them."""
    shown = [name if name.isprintable() and len(name) < 40 else ascii(name)[:40] for name in names[:5]]
    return ", ".join(shown) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def write_spectra(spectra: Spectra, file: Path | IO[bytes]) -> None:
    """Write a spectra file; the same spectra make the same bytes."""
    with h5py.File(file, "w") as opened:
        opened.attrs["format"] = FORMAT
        opened.attrs["resistance_ohm"] = spectra.resistance_ohm
        opened.attrs.update({f"{_ARM}{letter}": azimuth for letter, azimuth in spectra.arms_deg.items()})
        opened["frequency_mhz"] = spectra.frequency_mhz
        opened["power"] = spectra.power
        for name in (*_COLUMNS, *_OPTIONAL):
            values = getattr(spectra, name)
            if values is not None:
                # texts of one length: ten times as fast to write and read as texts that each have their own
                opened[name] = np.char.encode(values, "utf-8") if values.dtype.kind == "U" else values
        for name, values in spectra.environment.items():
            opened[f"env/{name}"] = values


# Spectra of several files as one: the same channels, every spectrum once.


def join_spectra(parts: Sequence[Spectra]) -> Spectra:
    """Join spectra of one experiment, such as one file a month.

    A spectrum that stands in two files is taken once if it is the same in both, and a `BadInputError` if it is not, as
    other channels are. A covariate that a file lacks is unknown there.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    for one in parts[1:]:
        require_same_grid(one.origin, one.frequency_mhz, first.frequency_mhz, first.origin)
        if one.resistance_ohm != first.resistance_ohm:
            raise BadInputError(
                f"{one.origin}: resistance_ohm",
                f"{first.resistance_ohm:g} as in {first.origin}",
                f"{one.resistance_ohm:g}",
            )
        if not np.array_equal(one.channel_widths(), first.channel_widths()):
            raise BadInputError(f"{one.origin}: width_mhz", f"those of {first.origin}", "others")
        if (one.duration_s is None) != (first.duration_s is None):
            has, lacks = (one, first) if first.duration_s is None else (first, one)
            raise BadInputError(f"{lacks.origin}: duration_s", f"durations as in {has.origin}", "none")
        for letter, azimuth in one.arms_deg.items():
            if azimuth != first.arms_deg.get(letter, azimuth):
                place = f"{one.origin}: arm of {letter}"
                raise BadInputError(place, f"{first.arms_deg[letter]:g} deg as in {first.origin}", f"{azimuth:g} deg")
    parts = _without_repetitions(parts)
    names = sorted({name for part in parts for name in part.environment})
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _BY_ROW}
    durations = [part.duration_s for part in parts if part.duration_s is not None]
    known = {name: [part.environment.get(name, np.full(len(part), np.nan)) for part in parts] for name in names}
    return Spectra(
        first.frequency_mhz,
        **columns,
        resistance_ohm=first.resistance_ohm,
        environment={name: np.concatenate(values) for name, values in known.items()},
        origin=f"{first.origin} and {len(parts) - 1} more",
        width_mhz=first.width_mhz,
        duration_s=np.concatenate(durations) if durations else None,
        left_out={flag: sum(part.left_out.get(flag, 0) for part in parts) for part in parts for flag in part.left_out},
        arms_deg={letter: azimuth for part in parts for letter, azimuth in part.arms_deg.items()},
    )


def _without_repetitions(parts: Sequence[Spectra]) -> list[Spectra]:
    """The parts without the rows that an earlier one has."""
    sizes = [len(part) for part in parts]
    keys = np.zeros(sum(sizes), dtype=np.int64)
    for name in _KEY:
        found, codes = np.unique(np.concatenate([getattr(part, name) for part in parts]), return_inverse=True)
        keys = keys * found.size + codes
    order = np.argsort(keys, kind="stable")
    repeats = order[1:][keys[order[1:]] == keys[order[:-1]]]
    first_of = dict(zip(keys[order[::-1]].tolist(), order[::-1].tolist(), strict=True)) if repeats.size else {}
    starts = np.concatenate([[0], np.cumsum(sizes)])
    keep = np.ones(keys.size, dtype=bool)
    for at in repeats.tolist():
        (one, row), (other, other_row) = (
            (int(part := np.searchsorted(starts, k, side="right") - 1), int(k - starts[part]))
            for k in (at, first_of[int(keys[at])])
        )
        _require_same(parts[one], row, parts[other], other_row)
        keep[at] = False
    chosen = np.split(keep, starts[1:-1])
    return [part if np.all(rows) else part.select(rows) for part, rows in zip(parts, chosen, strict=True)]


def _require_same(part: Spectra, row: int, other: Spectra, other_row: int) -> None:
    """Refuse two spectra of one path in one event that differ."""
    is_same = part.time_unix[row] == other.time_unix[other_row] and part.blocks[row] == other.blocks[other_row]
    if not (is_same and np.array_equal(part.power[row], other.power[other_row])):
        raise BadInputError(
            f"{part.origin}: row {row}",
            f"{part.name_row(row)} as in {other.origin}, row {other_row}",
            "another spectrum",
        )


# Spectra are named path by path and quarter by quarter, and a window by the sorted hashes of its quarters: a spectrum
# that arrives late changes the hash of one quarter of one path, and all others are what they were.

PathKey = tuple[str, int, str]
"""Station, antenna and dipole."""
Quarters = Mapping[PathKey, Mapping[int, str]]
"""The hash of what each path recorded in each quarter, by the number of the quarter."""
MONTHS = 3


def number_quarters(time_unix: Floats) -> NDArray[np.int64]:
    """Quarters of the calendar (UTC) since 1970 that instants, s UTC, lie in."""
    months = np.floor(time_unix).astype("datetime64[s]").astype("datetime64[M]")
    return np.asarray(months.astype(np.int64) // MONTHS)


def hash_quarters(
    paths: Sequence[PathKey],
    path_of: NDArray[np.int64],
    order: NDArray[np.int64],
    time_unix: Floats,
    columns: Sequence[Any],
) -> Quarters:
    """The hash of what each path recorded in each quarter.

    Parameters
    ----------
    path_of
        Number of the path of each row, shape (row,).
    order
        Rows in order of path and event: the order in which they are stored does not count.
    columns
        What is recorded, one entry a row each.
    """
    quarter = number_quarters(time_unix)
    order = order[np.lexsort((quarter[order], path_of[order]))]
    ends = np.flatnonzero(np.diff(path_of[order]) | np.diff(quarter[order])) + 1
    found: dict[PathKey, dict[int, str]] = {}
    for rows in np.split(order, ends) if order.size else []:
        station, antenna, dipole = paths[path_of[rows[0]]]
        number = int(quarter[rows[0]])
        of_rows = hash_arrays(*(column[rows] for column in columns))
        of_path = found.setdefault((station, antenna, dipole), {})
        of_path[number] = hash_content([station, antenna, dipole, number, of_rows])
    return found


def pick_hashes(quarters: Quarters, station: str | None, antenna: int | None, dipole: str | None) -> list[str]:
    """The hashes of one path, or of all paths with what of the name is given."""
    if station is not None and antenna is not None and dipole is not None:
        return list(quarters.get((station, antenna, dipole), {}).values())
    asked = (station, antenna, dipole)
    named = [path for path in quarters if all(want in (None, have) for want, have in zip(asked, path, strict=True))]
    return [value for path in named for value in quarters[path].values()]


def hash_window(frequency_mhz: Floats, resistance_ohm: float, width_mhz: Floats | None, hashes: Iterable[str]) -> str:
    """The hash of all spectra of a window, from those of its quarters in any order."""
    grid = hash_arrays(frequency_mhz, [resistance_ohm], [] if width_mhz is None else width_mhz)
    return hash_content([grid, sorted(hashes)])
