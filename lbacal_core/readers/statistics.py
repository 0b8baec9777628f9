"""Station statistics of LOFAR: the power of every sub-band and dipole, once a second (SST).

LOFAR 2.0 writes one dataset a second into HDF5 (the layout of the package lofar-stingray 1.0.8); LOFAR before it a
file `..._sst_rcuNNN.dat` for each receiver, 512 doubles a second.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, reading
from lbacal_core.foreign import parse_instant
from lbacal_core.grids import DAY_S, JULIAN_DATE_OF_1970, Floats
from lbacal_core.hdf5 import HDF5_FAILURES
from lbacal_core.readers.source import Integrations, Source

SUB_BANDS = 512
LBA_CLOCK_HZ = 200e6
AT_ONCE = 60
"""Integrations in memory."""
INPUTS_PER_FPGA = 12
"""Signal inputs of one FPGA of LOFAR 2.0's station digital processor: six antennas of two dipoles."""
UNUSABLE = ("BROKEN", "OFF", "BEYOND_REPAIR")
"""States of an antenna in which nothing that it sends counts."""
_FILE = re.compile(r"(?P<begin>\d{8}_\d{6})_sst_rcu(?P<rcu>\d{3})\.dat")


def open_statistics(path: Path) -> Source:
    """Open a LOFAR 2.0 file of sub-band statistics."""
    with reading(f"{path}: expected sub-band statistics (HDF5)", *HDF5_FAILURES), h5py.File(path, "r") as file:
        return _describe(path, file)


def is_statistics(path: Path) -> bool:
    """Whether a file is LOFAR 2.0's HDF5 of statistics."""
    if not h5py.is_hdf5(path):
        return False
    with h5py.File(path, "r") as file:
        return "data_type" in file.attrs and "writer_version" in file.attrs


def _describe(path: Path, file: h5py.File) -> Source:
    kind = _text(file.attrs.get("data_type", ""))
    names = sorted(name for name in file if name.startswith("SST_"))
    if kind.upper() != "SST" or not names:
        raise BadInputError(
            f"{path}: attribute data_type", "SST, with datasets SST_...", f"{kind}, {len(names)} of them"
        )
    first = file[names[0]]
    if first.ndim != 2:
        raise BadInputError(f"{path}: {names[0]}", "two dimensions (input, sub-band)", f"shape {first.shape}")
    frequency_hz = np.asarray(first.attrs["frequencies"], dtype=float)
    if frequency_hz.shape != (first.shape[1],):
        raise BadInputError(f"{path}: {names[0]}: frequencies", f"{first.shape[1]} numbers", f"{frequency_hz.shape}")
    channels = np.flatnonzero(frequency_hz > 0)
    channels = channels[np.argsort(frequency_hz[channels])]
    clock_hz = float(first.attrs.get("clock", 0.0)) or LBA_CLOCK_HZ
    inputs, antennas, letters, left_out = _list_inputs(path, file, first.shape[0])
    station = _text(file.attrs.get("station_name", "")) or path.stem
    notes = ["the unit of the power is the station's: C becomes relative"]
    boards = [str(board) for board in np.ravel(file.attrs.get("rcu_pcb_id", [])) if board > 0]
    if boards:
        notes.append(f"recorded with the RCU boards {', '.join(boards)}")
    if left_out:
        notes.append(f"left out by the antenna status or the usage mask: {', '.join(left_out)}")
    return Source(
        name=path.name,
        frequency_mhz=frequency_hz[channels] / 1e6,
        width_mhz=np.full(channels.size, clock_hz / 2 / SUB_BANDS / 1e6),
        station=np.full(inputs.size, station),
        antenna=antennas,
        dipole=letters,
        read=lambda: _read(path, names, inputs, channels),
        notes=tuple(notes),
    )


def _list_inputs(
    path: Path, file: h5py.File, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.str_], list[str]]:
    """The row of each usable dipole, its antenna and its letter, and the names of the antennas that are not usable.

    X is the even input of an antenna, Y the odd one.
    """
    mapping = np.ravel(file.attrs.get("antenna_to_sdp_mapping", [])).astype(np.int64).reshape(-1, 2)
    if mapping.size:
        first = max(int(file.attrs.get("first_signal_input_index", 0)), 0)
        even = np.where(mapping.min(axis=1) >= 0, mapping @ [INPUTS_PER_FPGA, 2] - first, -1)
    else:
        even = np.arange(0, rows - 1, 2)
    names = [_text(name) for name in np.ravel(file.attrs.get("antenna_names", []))]
    names = names if len(names) == even.size else [str(k) for k in range(even.size)]
    status = [_text(state) for state in np.ravel(file.attrs.get("antenna_status", []))]
    mask = np.ravel(file.attrs.get("antenna_usage_mask", [])).astype(bool)
    is_used = mask.copy() if mask.size == even.size else np.ones(even.size, dtype=bool)
    if len(status) == even.size:
        is_used &= np.array([state.upper() not in UNUSABLE for state in status])
    is_connected = (even >= 0) & (even + 1 < rows)
    antennas = np.flatnonzero(is_connected & is_used)
    if antennas.size == 0:
        raise BadInputError(str(path), "at least one antenna in use", "none")
    inputs = (even[antennas, None] + [0, 1]).ravel()
    letters = np.tile(["X", "Y"], antennas.size)
    return inputs, np.repeat(antennas, 2), letters, [names[k] for k in np.flatnonzero(is_connected & ~is_used)]


def _read(
    path: Path, names: list[str], inputs: NDArray[np.int64], channels: NDArray[np.int64]
) -> Iterator[Integrations]:
    wanted = np.ix_(inputs, channels)
    for start in range(0, len(names), AT_ONCE):
        some = names[start : start + AT_ONCE]
        power = np.empty((len(some), inputs.size, channels.size), dtype=np.float32)
        begin, length = np.empty(len(some)), np.empty(len(some))
        # HDF5 keeps 5 KiB of every dataset that was opened until the file is closed: half a gigabyte a day.
        with h5py.File(path, "r") as file:
            for k, name in enumerate(some):
                expected = f"{path}: {name}: expected statistics with timestamp and integration_time"
                with reading(expected, *HDF5_FAILURES, IndexError):
                    dataset = file[name]
                    begin[k] = parse_instant(_text(dataset.attrs["timestamp"]), f"{path}: time")
                    length[k] = float(dataset.attrs["integration_time"])
                    power[k] = dataset[()][wanted] / np.float32(length[k])
        yield Integrations(begin + length / 2, length, power)


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def find_receiver_files(folder: Path) -> list[Path]:
    """The files of LOFAR 1 in a folder, one a receiver, in order of receivers."""
    return sorted((file for file in folder.iterdir() if _FILE.fullmatch(file.name)), key=lambda file: file.name)


def open_receiver_files(files: list[Path], station: str) -> Source:
    """Open the files that one station of LOFAR 1 wrote at the same time: even receivers are X, odd ones Y.

    The letters hold for the outer antennas of LBA_OUTER as for the inner of LBA_INNER only where parity is the letter:
    the note says so, and `lbacal audit` tests it.
    """
    found = [match for file in files if (match := _FILE.fullmatch(file.name))]
    begins = sorted({match["begin"] for match in found})
    if len(begins) != 1:
        raise BadInputError(files[0].parent.name, "files that begin together", f"{len(begins)} beginnings")
    sizes = {file.stat().st_size // (8 * SUB_BANDS) for file in files}
    seconds = min(sizes)
    receivers = np.array([int(match["rcu"]) for match in found], dtype=np.int64)
    begin = datetime.strptime(begins[0], "%Y%m%d_%H%M%S").replace(tzinfo=UTC).timestamp()
    centre = np.arange(1, SUB_BANDS) * LBA_CLOCK_HZ / 2 / SUB_BANDS / 1e6
    return Source(
        name=files[0].parent.name or str(files[0]),
        frequency_mhz=centre,
        width_mhz=np.full(centre.size, LBA_CLOCK_HZ / 2 / SUB_BANDS / 1e6),
        station=np.full(receivers.size, station),
        antenna=receivers // 2,
        dipole=np.where(receivers % 2 == 0, "X", "Y"),
        read=lambda: _read_receivers(files, seconds, begin),
        notes=(
            "the unit of the power is the station's: C becomes relative",
            "even receivers are called X: `lbacal audit` tests whether they are",
        ),
    )


def _read_receivers(files: list[Path], seconds: int, begin: float) -> Iterator[Integrations]:
    series = [np.memmap(file, dtype="<f8", mode="r").reshape(-1, SUB_BANDS) for file in files]
    for start in range(0, seconds, AT_ONCE):
        rows = slice(start, min(start + AT_ONCE, seconds))
        power: Floats = np.stack([values[rows, 1:] for values in series], axis=1)
        count = power.shape[0]
        yield Integrations(begin + start + 0.5 + np.arange(count, dtype=float), np.ones(count), np.asarray(power))


# Station statistics of NenuFAR: the power of every mini-array, polarisation and sub-band, once a second (SST).
#
# The layout is the one that the package nenupy 2.8.5 reads (`nenupy.io.sst`, `nenupy.io.io_tools`): FITS, whose first
# extension holds the frequencies `frq` (MHz, middle of the sub-bands), the mini-arrays `noMROn` and the names `spol` of
# the polarisations (NW, NE), and whose seventh holds `JD` and `data`, shape (time, mini-array, polarisation, sub-band).

NENUFAR_SUFFIXES = (".fits", ".fit")
INSTRUMENT, DATA = 1, 7
"""Numbers of the extensions."""
WIDTH_MHZ = 0.1953125
SECOND = 1.0
STATION = "NenuFAR"
FAILURES = (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError)
"""What astropy raises on broken files."""


def open_mini_arrays(path: Path, station: str | None = None) -> Source:
    """Open a file of NenuFAR's sub-band statistics; a mini-array is an antenna, NW and NE are its dipoles."""
    from astropy.io import fits

    with reading(f"{path}: expected NenuFAR's statistics (FITS)", *FAILURES), fits.open(path, memmap=True) as file:
        facts, rows = file[INSTRUMENT].data, file[DATA].data
        frequency = np.asarray(facts["frq"][0], dtype=float)
        antennas = np.asarray(facts["noMROn"][0], dtype=np.int64)
        letters = np.array([str(name).strip() for name in np.atleast_1d(facts["spol"][0])])
        time = (np.asarray(rows["JD"], dtype=float) - JULIAN_DATE_OF_1970) * DAY_S
        shape = rows["data"].shape
    expected = (time.size, antennas.size, letters.size, frequency.size)
    if shape != expected or time.size == 0:
        raise BadInputError(f"{path}: data", f"shape {expected} (time, mini-array, polarisation, sub-band)", f"{shape}")
    if np.any(np.diff(time) <= 0):
        raise BadInputError(f"{path}: JD", "instants in order of time", "others")
    order = np.argsort(frequency)
    return Source(
        name=path.name,
        frequency_mhz=frequency[order],
        width_mhz=np.full(frequency.size, WIDTH_MHZ),
        station=np.full(antennas.size * letters.size, station or STATION),
        antenna=np.repeat(antennas, letters.size),
        dipole=np.tile(letters, antennas.size),
        read=lambda: _read_mini_arrays(path, time, order),
        notes=(
            "the unit of the power is the station's: C becomes relative",
            "an antenna is a mini-array of 19: the pattern of the instrument must be its, where its beam pointed",
        ),
        arms_deg={"NE": 45.0, "NW": 135.0},
    )


def _read_mini_arrays(path: Path, time: NDArray[np.float64], order: NDArray[np.int64]) -> Iterator[Integrations]:
    from astropy.io import fits

    length = np.full(time.size, np.median(np.diff(time)) if time.size > 1 else SECOND)
    with fits.open(path, memmap=True) as file:
        data = file[DATA].data["data"]
        for start in range(0, time.size, AT_ONCE):
            rows = slice(start, start + AT_ONCE)
            block = np.asarray(data[rows], dtype=float)[..., order]
            yield Integrations(time[rows] + length[rows] / 2, length[rows], block.reshape(len(block), -1, order.size))
