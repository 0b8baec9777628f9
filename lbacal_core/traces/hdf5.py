"""LOFAR TBB time series in HDF5: the layout of 2008 and the documented one (ICD 001, LOFAR data access library).

2008: groups `Station001`, datasets `001001009` (station, board, receiver), attributes as arrays of one.
Later: groups `STATION_CS002` or `Station_002` with `STATION_NAME`, datasets `DIPOLE_002001009`, scalar attributes,
`ANTENNA_SET` on the file, `FLAG_OFFSETS` (begin, end) for samples that the writer knows to be bad.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.hdf5 import HDF5_FAILURES, is_in_file
from lbacal_core.traces.trace import BLOCK_SAMPLES, UNKNOWN_ANTENNA_SET, Trace, TraceReference, name_station

_DIPOLE = re.compile(r"(?:DIPOLE_?)?(\d{3})(\d{3})(\d{3})", re.IGNORECASE)
_UNITS_HZ = {"HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6, "GHZ": 1e9}
_NOT_SET = ("", "NULL", UNKNOWN_ANTENNA_SET)


def list_hdf5_traces(path: Path, antenna_set: str | None = None) -> list[TraceReference]:
    """Find the traces in a TBB file in HDF5."""
    try:
        with h5py.File(path, "r") as file:
            references = _list_open_file(file, path, antenna_set)
    except HDF5_FAILURES as error:
        raise UnreadableFileError(f"{path}: expected a TBB file (HDF5), found something unreadable") from error
    if not references:
        raise UnreadableFileError(f"{path}: expected station groups with dipole datasets, found none")
    return references


def _list_open_file(file: h5py.File, path: Path, antenna_set: str | None) -> list[TraceReference]:
    recorded_set = str(_attribute(file, "ANTENNA_SET", UNKNOWN_ANTENNA_SET))
    if recorded_set.upper() in _NOT_SET:
        recorded_set = UNKNOWN_ANTENNA_SET
    references = []
    for group in file:
        if not group.lower().startswith("station") or not _is_inside(file, group, h5py.Group):
            continue
        station_name = str(_attribute(file[group], "STATION_NAME", ""))
        for name in file[group]:
            match = _DIPOLE.fullmatch(name)
            if match is None or not _is_inside(file[group], name, h5py.Dataset):
                continue
            dataset = file[group][name]
            if dataset.ndim != 1 or dataset.dtype.kind != "i":
                raise BadInputError(f"{path}: {group}/{name}", "integer samples in 1 dimension", str(dataset.dtype))
            station_id = int(_attribute(dataset, "STATION_ID", int(match[1])))
            references.append(
                TraceReference(
                    path=path,
                    dataset=f"{group}/{name}",
                    station=name_station(station_id) if station_name.upper() in _NOT_SET else station_name,
                    rcu=int(_attribute(dataset, "RCU_ID", int(match[3]))),
                    start_s=int(_required(dataset, "TIME", path)),
                    start_sample=int(_required(dataset, "SAMPLE_NUMBER", path)),
                    sample_rate_hz=_sample_rate(dataset, path),
                    antenna_set=antenna_set or recorded_set,
                )
            )
    return references


def read_hdf5_trace(reference: TraceReference) -> Trace:
    """Read one dipole's dataset; blocks that the writer filled with zeros were lost."""
    try:
        with h5py.File(reference.path, "r") as file:
            dataset = file[reference.dataset]
            samples = np.asarray(dataset[()])
            declared = int(_attribute(dataset, "DATA_LENGTH", samples.size))
            count = samples.size // BLOCK_SAMPLES
            is_in_flags = _blocks_in_ranges(_attribute(dataset, "FLAG_OFFSETS", None), count)
    except HDF5_FAILURES as error:
        raise UnreadableFileError(f"{reference.path}: dataset {reference.dataset} cannot be read ({error})") from error
    if samples.size and (samples.min() < -32768 or samples.max() > 32767):
        raise BadInputError(f"{reference.path}: {reference.dataset}", "16-bit samples", f"{samples.dtype}")
    blocks = samples[: count * BLOCK_SAMPLES].reshape(count, BLOCK_SAMPLES).astype(np.int16)
    is_lost = ~np.any(blocks, axis=1)
    is_flagged = is_in_flags & ~is_lost
    faults = {
        "lost_frames": int(np.sum(is_lost)),
        "flagged_blocks": int(np.sum(is_flagged)),
        "missing_samples": max(declared - samples.size, 0),
        "unannounced_samples": max(samples.size - declared, 0),
        "trailing_samples": samples.size % BLOCK_SAMPLES,
    }
    first = reference.start_sample // BLOCK_SAMPLES
    return Trace(
        reference=reference,
        samples=blocks,
        position=first + np.arange(count, dtype=np.int64),
        is_intact=~is_lost & ~is_flagged,
        faults={name: number for name, number in faults.items() if number},
    )


def _blocks_in_ranges(flags: Any, count: int) -> NDArray[np.bool_]:
    is_inside = np.zeros(count, dtype=bool)
    if flags is None:
        return is_inside
    table = np.asarray(flags)
    if table.dtype.names:
        table = np.stack([table[name] for name in table.dtype.names[:2]], axis=-1)
    for begin, end in table.reshape(-1, 2).astype(np.int64):
        is_inside[begin // BLOCK_SAMPLES : -(-end // BLOCK_SAMPLES)] = True
    return is_inside


def _sample_rate(dataset: h5py.Dataset, path: Path) -> float:
    value = float(_required(dataset, "SAMPLE_FREQUENCY_VALUE", path))
    unit = str(_attribute(dataset, "SAMPLE_FREQUENCY_UNIT", "MHz"))
    if unit.upper() not in _UNITS_HZ:
        raise BadInputError(f"{path}: SAMPLE_FREQUENCY_UNIT", "Hz, kHz, MHz or GHz", repr(unit))
    return value * _UNITS_HZ[unit.upper()]


def _required(dataset: h5py.Dataset, name: str, path: Path) -> Any:
    value = _attribute(dataset, name, None)
    if value is None:
        raise BadInputError(f"{path}: {dataset.name}", f"the attribute {name}", "none")
    return value


def _attribute(node: Any, name: str, default: Any) -> Any:
    """An attribute, whether stored as a scalar (later files) or as an array of one (2008)."""
    if name not in node.attrs:
        return default
    value = node.attrs[name]
    if isinstance(value, np.ndarray) and value.size == 1 and not value.dtype.names:
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _is_inside(parent: h5py.Group, name: str, kind: type) -> bool:
    """Whether a name is of a kind and stored in this file."""
    return is_in_file(parent, name) and isinstance(parent[name], kind)
