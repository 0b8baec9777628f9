"""Raw frames of LOFAR's transient buffer boards (TBB): 88 bytes of header, 1024 samples, 4 bytes of checksum.

Both checksums are verified. The rule was found by trying the usual polynomials on the four dumps of 2011-07-19, of
which all 4000 frames then agree: CRC-16 (0x8005) of the header with its sequence number taken as zero, and CRC-32
(0x04C11DB7) of the samples; both start from 0, run from the highest bit, and see 16-bit words with the high byte first.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.trace import BLOCK_SAMPLES, UNKNOWN_ANTENNA_SET, Trace, TraceReference, name_station

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
