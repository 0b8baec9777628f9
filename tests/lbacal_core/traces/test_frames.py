from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.trace import (
    FRAME,
    Trace,
    TraceReference,
    header_checksums,
    list_frame_traces,
    read_frame_trace,
    sample_checksums,
)
from lbacal_twin.voltages import write_frames

COUNT = 40


@pytest.fixture
def dump(tmp_path: Path) -> Path:
    path = tmp_path / "dump.dat"
    samples = np.random.default_rng(1).normal(scale=20, size=COUNT * 1024).astype(np.int16)
    write_frames(path, samples, TraceReference(path, "10", "CS011", 10, 1_311_073_541, 7_283_712, 200e6), 11)
    return path


def _frames(path: Path) -> NDArray[np.void]:
    return np.fromfile(path, dtype=FRAME)


def _read(path: Path) -> Trace:
    (reference,) = list_frame_traces(path)
    return read_frame_trace(reference)


def _crc(data: bytes, polynomial: int, width: int) -> int:
    """The textbook bit by bit."""
    register, top = 0, 1 << (width - 1)
    for byte in data:
        register ^= byte << (width - 8)
        for _ in range(8):
            register = (register << 1) ^ (polynomial if register & top else 0)
            register &= (1 << width) - 1
    return register


def test_fast_checksums_equal_the_textbook(dump: Path) -> None:
    frame = _frames(dump)[3:4]
    header = bytearray(frame.tobytes()[:86])
    header[4:8] = bytes(4)
    words = np.frombuffer(bytes(header), dtype="<u2").byteswap().tobytes()
    assert header_checksums(frame)[0] == _crc(words, 0x8005, 16)
    payload = np.frombuffer(frame.tobytes()[88:2136], dtype="<u2").byteswap().tobytes()
    assert sample_checksums(frame["samples"])[0] == _crc(payload, 0x04C11DB7, 32)


def test_a_perfect_dump_has_no_faults(dump: Path) -> None:
    trace = _read(dump)
    assert trace.faults == {}
    assert np.all(trace.is_intact)
    assert np.array_equal(trace.samples, _frames(dump)["samples"])
    assert np.array_equal(trace.position, 7113 + np.arange(COUNT))


def test_lost_repeated_and_shuffled_frames_are_put_in_order_and_counted(dump: Path) -> None:
    frames = _frames(dump)
    order = [0, 2, 1, 3, 4, 4, 4, *range(8, COUNT)]
    dump.write_bytes(frames[order].tobytes())
    trace = _read(dump)
    assert trace.faults == {"lost_frames": 3, "repeated_frames": 2}
    kept = [0, 1, 2, 3, 4, *range(8, COUNT)]
    assert np.array_equal(trace.position, 7113 + np.array(kept))
    assert np.array_equal(trace.samples, frames["samples"][kept])


def test_damage_is_seen_by_the_checksums_and_a_good_copy_is_preferred(dump: Path) -> None:
    frames = _frames(dump)
    damaged = frames.copy()
    damaged["samples"][5, 100] ^= 1
    damaged["samples"][7, 0] ^= 4
    damaged["sample"][9] += 1024  # the header no longer fits its checksum
    dump.write_bytes(np.concatenate([damaged, frames[7:8]]).tobytes())
    trace = _read(dump)
    assert trace.faults == {"damaged_headers": 1, "damaged_frames": 2, "repeated_frames": 1, "lost_frames": 1}
    assert trace.position[~trace.is_intact] - 7113 == [5]


def test_wrong_sample_counts_and_trailing_bytes_are_reported(dump: Path) -> None:
    frames = _frames(dump)
    frames["samples_per_frame"][4] = 512
    frames["header_crc"] = header_checksums(frames)
    dump.write_bytes(frames.tobytes() + b"cut off")
    trace = _read(dump)
    assert trace.faults == {"short_frames": 1, "trailing_bytes": 7}
    assert np.sum(~trace.is_intact) == 1


def test_a_trace_may_cross_a_second(tmp_path: Path) -> None:
    path = tmp_path / "late.dat"
    samples = np.arange(COUNT * 1024, dtype=np.int64).astype(np.int16)
    start = 200_000_000 - 20 * 1024
    write_frames(path, samples, TraceReference(path, "11", "CS011", 11, 1_311_073_541, start, 200e6), 11)
    assert set(_frames(path)["time"]) == {1_311_073_541, 1_311_073_542}
    trace = _read(path)
    assert trace.faults == {}
    assert np.array_equal(trace.samples.ravel(), samples)


def test_several_receivers_in_one_file_are_several_traces(dump: Path) -> None:
    other = _frames(dump)
    other["rcu"] = 33
    other["header_crc"] = header_checksums(other)
    dump.write_bytes(np.stack([_frames(dump), other], axis=1).tobytes())
    first, second = list_frame_traces(dump)
    assert (first.rcu, second.rcu) == (10, 33)
    assert read_frame_trace(second).faults == {}


def test_other_files_and_subband_frames_are_refused_in_one_sentence(dump: Path, tmp_path: Path) -> None:
    noise = tmp_path / "noise.dat"
    noise.write_bytes(np.random.default_rng(2).bytes(3 * FRAME.itemsize))
    with pytest.raises(UnreadableFileError, match="no valid frame header"):
        list_frame_traces(noise)
    noise.write_bytes(b"short")
    with pytest.raises(UnreadableFileError, match="5 bytes"):
        list_frame_traces(noise)
    frames = _frames(dump)
    frames["bands_per_frame"] = 3
    frames["header_crc"] = header_checksums(frames)
    dump.write_bytes(frames.tobytes())
    with pytest.raises(BadInputError, match="3 bands"):
        list_frame_traces(dump)


@pytest.mark.shared
def test_every_checksum_of_the_real_dumps_agrees(shared: Path) -> None:
    files = sorted((shared / "data/tbb").glob("*.dat"))
    assert len(files) == 4
    starts = []
    for file, rcu in zip(files, (10, 11, 12, 13), strict=True):
        (reference,) = list_frame_traces(file)
        trace = read_frame_trace(reference)
        assert (reference.station, reference.rcu, reference.sample_rate_hz) == ("CS011", rcu, 200e6)
        assert reference.start_s == 1_311_073_541  # 2011-07-19 11:05:41 UTC
        assert trace.faults == {}
        assert trace.samples.shape == (1000, 1024)
        starts.append(reference.start_sample)
    assert starts == [7_283_712, 7_284_736, 7_289_856, 7_290_880]
