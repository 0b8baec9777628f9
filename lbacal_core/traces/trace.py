"""One dipole's raw trace: its header, and its samples in blocks of 1024."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError, reading, require_name
from lbacal_core.hdf5 import HDF5_FAILURES, is_in_file
from lbacal_core.spectra.spectra import name_event

BLOCK_SAMPLES = 1024
"""Samples of a block (5.12 us at 200 MHz), which is also what one TBB frame holds."""

ADC_LOWEST, ADC_HIGHEST = -2048, 2047
"""Range of the 12-bit converters (van Haarlem et al. 2013, A&A 556, A2, section 4.2)."""

UNKNOWN_ANTENNA_SET = "UNDEFINED"
INNER, OUTER = "inner", "outer"
FIELDS = {
    "LBA_INNER": (INNER, INNER),
    "LBA_OUTER": (OUTER, OUTER),
    "LBA_SPARSE_EVEN": (INNER, OUTER),
    "LBA_SPARSE_ODD": (OUTER, INNER),
}
"""Antenna field of the even and of the odd antennas in each set (AntennaSets.conf of the observatory: inputs h are the
inner field, inputs l the outer one)."""
ONE_LETTER = {"LBA_X": "X", "LBA_Y": "Y"}
"""Sets in which every receiver has the same letter."""
ANTENNA_SETS = (*FIELDS, *ONE_LETTER)

_CORE_STATIONS = frozenset({101, 103, 201, 301, 302, 401, 501})
_COUNTRIES = {
    **dict.fromkeys((601, 602, 603, 604, 605, 609), "DE"),
    606: "FR",
    607: "SE",
    608: "UK",
    **dict.fromkeys((610, 611, 612), "PL"),
    613: "IE",
    614: "LV",
}


def name_station(station_id: int) -> str:
    """Name of a station from the number in a TBB header.

    The number is one byte, so stations beyond 100 are packed: CS302 is 142, RS508 is 188, DE601 is 201;
    hundreds count by 20 from 101. A number that names no station known here still gives a name.
    """
    number = station_id if station_id <= 100 else 100 * (1 + (station_id - 101) // 20) + (station_id - 101) % 20 + 1
    country = "CS" if number < 100 or number in _CORE_STATIONS else _COUNTRIES.get(number, "RS")
    return f"{country}{number:03d}"


def name_dipole(rcu: int, antenna_set: str) -> str:
    """Dipole on a receiver (RCU): X on even and Y on odd numbers of the inner field, the reverse in the outer field.

    X is the arm from north-east to south-west, Y from north-west to south-east. In the outer field the two are
    connected the other way round, which the stations undo for their beams (`rspctl --swapxy=1` in modes 1 and 2,
    LOFAR station scripts, Norden and Romein 2011) but not in the transient buffers (LoLIM `raw_tbb_IO`, Hare). The
    cross-correlations of a station show it for every antenna (docs/explanation/x-and-y.md). Where the set is not on
    record the receivers' own labels hold.
    """
    if antenna_set in ONE_LETTER:
        return ONE_LETTER[antenna_set]
    field = FIELDS.get(antenna_set, (INNER, INNER))[rcu // 2 % 2]
    return "X" if (rcu % 2 == 0) == (field == INNER) else "Y"


def require_antenna_set(name: str | None) -> None:
    """Refuse the name of an antenna set whose letters are not known: the receivers' own would hold in silence."""
    if name is not None:
        require_name("antenna set", name, ANTENNA_SETS)


@dataclass(frozen=True)
class TraceReference:
    """The place and the header of one dipole's trace; its samples are not in memory.

    Attributes
    ----------
    dataset
        Path inside an HDF5 file, or the RCU in a file of raw frames.
    start_s, start_sample
        UTC second of the first sample, and its number within that second.
    antenna_set
        One of `ANTENNA_SETS`, of the high band, or `UNDEFINED` where the file does not state it.
    """

    path: Path
    dataset: str
    station: str
    rcu: int
    start_s: int
    start_sample: int
    sample_rate_hz: float
    antenna_set: str = UNKNOWN_ANTENNA_SET

    def __post_init__(self) -> None:
        if not 0 <= self.rcu < 192:
            raise BadInputError(f"{self.path}: RCU", "a receiver 0 to 191", str(self.rcu))
        if not 1e6 <= self.sample_rate_hz <= 1e10:
            raise BadInputError(f"{self.path}: sample rate", "1 MHz to 10 GHz", f"{self.sample_rate_hz:g} Hz")

    @property
    def time_unix(self) -> float:
        """Instant of the first sample, s since 1970, UTC."""
        return self.start_s + self.start_sample / self.sample_rate_hz

    @property
    def antenna(self) -> int:
        """Number of the antenna in its station, 0 to 47: two receivers an antenna."""
        return self.rcu // 2

    @property
    def dipole(self) -> str:
        """X or Y."""
        return name_dipole(self.rcu, self.antenna_set)

    @property
    def name(self) -> str:
        """The path in words."""
        return f"{self.station} antenna {self.antenna} {self.dipole} (RCU {self.rcu})"


@dataclass(frozen=True)
class Trace:
    """The samples of one dipole in blocks.

    Attributes
    ----------
    samples
        Shape (block, 1024), int16, ADC units; only blocks that exist.
    position
        Shape (block,), strictly rising: blocks since the UTC second of the reference. Gaps are lost blocks.
    is_intact
        Shape (block,): nothing is known against the block.
    faults
        What is wrong with the trace, by name, with counts.
    """

    reference: TraceReference
    samples: NDArray[np.int16]
    position: NDArray[np.int64]
    is_intact: NDArray[np.bool_]
    faults: Mapping[str, int]

    def __post_init__(self) -> None:
        blocks = len(self.samples)
        if self.samples.shape != (blocks, BLOCK_SAMPLES) or blocks == 0:
            expected = f"at least one block of {BLOCK_SAMPLES} samples"
            raise BadInputError(f"{self.reference.path}: samples", expected, f"shape {self.samples.shape}")
        if self.position.shape != (blocks,) or self.is_intact.shape != (blocks,):
            raise BadInputError(f"{self.reference.path}: position, is_intact", f"{blocks} entries", "another count")
        if np.any(np.diff(self.position) <= 0):
            raise BadInputError(f"{self.reference.path}: position", "rising block numbers", "repeated or falling ones")


# Raw frames of LOFAR's transient buffer boards (TBB): 88 bytes of header, 1024 samples, 4 bytes of checksum.
#
# Both checksums are verified. The rule was found by trying the usual polynomials on the four dumps of 2011-07-19, of
# which all 4000 frames then agree: CRC-16 (0x8005) of the header with its sequence number taken as zero, and CRC-32
# (0x04C11DB7) of the samples; both start from 0, run from the highest bit, and see 16-bit words with the high byte
# first.

FRAME = np.dtype(
    [
        ("station", "u1"),
        ("rsp", "u1"),
        ("rcu", "u1"),
        ("sample_rate_mhz", "u1"),
        ("sequence", "<u4"),
        ("time", "<u4"),
        ("sample", "<u4"),
        ("samples_per_frame", "<u2"),
        ("bands_per_frame", "<u2"),
        ("band_selection", "u1", 64),
        ("spare", "<u2"),
        ("header_crc", "<u2"),
        ("samples", "<i2", BLOCK_SAMPLES),
        ("samples_crc", "<u4"),
    ]
)
"""The layout, 2140 bytes."""

Frames = NDArray[np.void]

_HEADER_BYTES = 86
_SEQUENCE_BYTES = slice(4, 8)
_CRC16_POLYNOMIAL = 0x8005
_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def header_checksums(frames: Frames) -> NDArray[np.uint16]:
    """CRC-16 of every header, shape (frame,)."""
    table = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        table = np.where(table & 0x8000, (table << 1) ^ _CRC16_POLYNOMIAL, table << 1) & 0xFFFF
    raw = np.ascontiguousarray(frames).view(np.uint8).reshape(len(frames), FRAME.itemsize)
    header = raw[:, :_HEADER_BYTES].copy()
    header[:, _SEQUENCE_BYTES] = 0
    words_high_first = header.reshape(len(frames), -1, 2)[:, :, ::-1].reshape(len(frames), -1)
    register = np.zeros(len(frames), dtype=np.uint32)
    for byte in words_high_first.T:
        register = ((register << 8) & 0xFFFF) ^ table[(register >> 8) ^ byte]
    return register.astype(np.uint16)


def sample_checksums(samples: NDArray[np.int16]) -> NDArray[np.uint32]:
    """CRC-32 of the samples of every frame, shape (frame,).

    zlib runs from the lowest bit, so it is fed bit-reversed bytes and its answer is reversed back.
    """
    payload = samples.astype("<i2").byteswap().tobytes().translate(_REVERSED_BITS)
    size = 2 * BLOCK_SAMPLES
    start = 0xFFFFFFFF  # zlib inverts its register before and after
    codes = [zlib.crc32(payload[at : at + size], start) ^ start for at in range(0, len(payload), size)]
    return np.frombuffer(np.array(codes, dtype=">u4").tobytes().translate(_REVERSED_BITS), dtype="<u4")


def list_frame_traces(path: Path, antenna_set: str | None = None) -> list[TraceReference]:
    """Find the traces in a file of raw frames: one a receiver."""
    frames = _map_frames(path)
    is_header = _has_good_header(frames)
    if not np.any(is_header):
        raise UnreadableFileError(f"{path}: expected TBB frames of {FRAME.itemsize} bytes, found no valid frame header")
    references = []
    for rcu in np.unique(frames["rcu"][is_header]):
        of_rcu = frames[is_header & (frames["rcu"] == rcu)]
        first = of_rcu[np.lexsort((of_rcu["sample"], of_rcu["time"]))[0]]
        if first["bands_per_frame"] != 0:
            raise BadInputError(
                f"{path}: RCU {rcu}", "time series (0 bands a frame)", f"{first['bands_per_frame']} bands"
            )
        references.append(
            TraceReference(
                path=path,
                dataset=str(rcu),
                station=name_station(int(first["station"])),
                rcu=int(rcu),
                start_s=int(first["time"]),
                start_sample=int(first["sample"]),
                sample_rate_hz=1e6 * float(first["sample_rate_mhz"]),
                antenna_set=antenna_set or UNKNOWN_ANTENNA_SET,
            )
        )
    return references


def read_frame_trace(reference: TraceReference) -> Trace:
    """Read one receiver's frames, in order of time, with what is wrong with them."""
    mapped = _map_frames(reference.path)
    frames = np.array(mapped[mapped["rcu"] == reference.rcu])
    is_header = _has_good_header(frames)
    faults = {"damaged_headers": int(np.sum(~is_header))}
    frames = frames[is_header]
    elapsed = (frames["time"].astype(np.int64) - reference.start_s) * reference.sample_rate_hz + frames["sample"]
    since_start = np.rint((elapsed - reference.start_sample) / BLOCK_SAMPLES).astype(np.int64)
    position = reference.start_sample // BLOCK_SAMPLES + since_start
    is_short = frames["samples_per_frame"] != BLOCK_SAMPLES
    is_damaged = sample_checksums(frames["samples"]) != frames["samples_crc"]
    is_intact = ~is_short & ~is_damaged
    order = np.lexsort((~is_intact, position))
    _, first = np.unique(position[order], return_index=True)
    kept = order[first]
    faults |= {
        "damaged_frames": int(np.sum(is_damaged & ~is_short)),
        "short_frames": int(np.sum(is_short)),
        "repeated_frames": len(frames) - len(kept),
        "lost_frames": int(position[kept][-1] - position[kept][0] + 1 - len(kept)),
        "trailing_bytes": reference.path.stat().st_size % FRAME.itemsize,
    }
    return Trace(
        reference=reference,
        samples=np.ascontiguousarray(frames["samples"][kept]),
        position=position[kept],
        is_intact=is_intact[kept],
        faults={name: count for name, count in faults.items() if count},
    )


def _map_frames(path: Path) -> Frames:
    count = path.stat().st_size // FRAME.itemsize
    if count == 0:
        raise UnreadableFileError(
            f"{path}: expected TBB frames of {FRAME.itemsize} bytes, found {path.stat().st_size} bytes"
        )
    return np.memmap(path, dtype=FRAME, mode="r", shape=(count,))


def _has_good_header(frames: Frames) -> NDArray[np.bool_]:
    return np.asarray(header_checksums(frames) == frames["header_crc"])


# LOFAR TBB time series in HDF5: the layout of 2008 and the documented one (ICD 001, LOFAR data access library).
#
# 2008: groups `Station001`, datasets `001001009` (station, board, receiver), attributes as arrays of one.
# Later: groups `STATION_CS002` or `Station_002` with `STATION_NAME`, datasets `DIPOLE_002001009`, scalar attributes,
# `ANTENNA_SET` on the file, `FLAG_OFFSETS` (begin, end) for samples that the writer knows to be bad.

_DIPOLE = re.compile(r"(?:DIPOLE_?)?(\d{3})(\d{3})(\d{3})", re.IGNORECASE)
_UNITS_HZ = {"HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6, "GHZ": 1e9}
_NOT_SET = ("", "NULL", UNKNOWN_ANTENNA_SET)


def list_hdf5_traces(path: Path, antenna_set: str | None = None) -> list[TraceReference]:
    """Find the traces in a TBB file in HDF5."""
    with (
        reading(f"{path}: expected a TBB file (HDF5), found something unreadable", *HDF5_FAILURES),
        h5py.File(path, "r") as file,
    ):
        references = _list_open_file(file, path, antenna_set)
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
    place = f"{reference.path}: dataset {reference.dataset}"
    with reading(f"{place} cannot be read", *HDF5_FAILURES), h5py.File(reference.path, "r") as file:
        dataset = file[reference.dataset]
        samples = np.asarray(dataset[()])
        declared = int(_attribute(dataset, "DATA_LENGTH", samples.size))
        count = samples.size // BLOCK_SAMPLES
        is_in_flags = _blocks_in_ranges(_attribute(dataset, "FLAG_OFFSETS", None), count)
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


# Files and folders to station events: which traces were taken together.

SUFFIXES = (".h5", ".hdf5", ".dat")
EVENT_SPAN_S = 0.5
"""Traces that start within this of the first one belong to one event: the buffers hold seconds, dumps start apart by
microseconds (dipoles) to milliseconds (stations), and triggers are minutes apart."""


@dataclass(frozen=True)
class StationEvent:
    """The traces of one station in one event: the unit of work, and of memory."""

    event_id: str
    station: str
    references: tuple[TraceReference, ...]

    @property
    def name(self) -> str:
        """The event and station in words."""
        return f"{self.event_id} {self.station}"


def list_traces(path: Path, antenna_set: str | None = None) -> list[TraceReference]:
    """Find the traces in one file; `antenna_set` overrides that of the file."""
    if not path.is_file():
        raise UnreadableFileError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise UnreadableFileError(f"{path}: expected raw traces, found an empty file")
    is_hdf5 = h5py.is_hdf5(path) or path.suffix in (".h5", ".hdf5")
    return list_hdf5_traces(path, antenna_set) if is_hdf5 else list_frame_traces(path, antenna_set)


def read_trace(reference: TraceReference) -> Trace:
    """Read the samples of one trace."""
    return read_frame_trace(reference) if reference.dataset.isdigit() else read_hdf5_trace(reference)


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files as given, and those below folders that could hold traces, in order of name."""
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += sorted(file for file in path.rglob("*") if file.is_file() and file.suffix in SUFFIXES)
        else:
            files.append(path)
    return list(dict.fromkeys(files))


def group_traces(references: Sequence[TraceReference], event_id: str | None = None) -> list[StationEvent]:
    """Sort traces into events and stations.

    An event is named after its first trace, so one that crosses a full second keeps one name as long as its files are
    given together.
    """
    order = np.argsort([reference.time_unix for reference in references], kind="stable")
    groups: dict[tuple[str, str], list[TraceReference]] = {}
    start = -np.inf
    for k in order:
        reference = references[k]
        if reference.time_unix - start > EVENT_SPAN_S:
            start = reference.time_unix
        key = (event_id or name_event(start), reference.station)
        groups.setdefault(key, []).append(reference)
    events = []
    for (event, station), members in groups.items():
        members.sort(key=lambda reference: reference.rcu)
        for left, right in pairwise(members):
            if left.rcu == right.rcu:
                place = f"event {event}, {station}, RCU {left.rcu}"
                raise BadInputError(place, "one trace", f"{left.path.name} and {right.path.name}")
        events.append(StationEvent(event, station, tuple(members)))
    return events
