from pathlib import Path
from typing import Any

import h5py
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
    list_hdf5_traces,
    read_frame_trace,
    read_hdf5_trace,
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


def test_fast_checksums_equal_the_textbook(dump):
    frame = _frames(dump)[3:4]
    header = bytearray(frame.tobytes()[:86])
    header[4:8] = bytes(4)
    words = np.frombuffer(bytes(header), dtype="<u2").byteswap().tobytes()
    assert header_checksums(frame)[0] == _crc(words, 0x8005, 16)
    payload = np.frombuffer(frame.tobytes()[88:2136], dtype="<u2").byteswap().tobytes()
    assert sample_checksums(frame["samples"])[0] == _crc(payload, 0x04C11DB7, 32)


def test_a_perfect_dump_has_no_faults(dump):
    trace = _read(dump)
    assert trace.faults == {}
    assert np.all(trace.is_intact)
    assert np.array_equal(trace.samples, _frames(dump)["samples"])
    assert np.array_equal(trace.position, 7113 + np.arange(COUNT))


def test_lost_repeated_and_shuffled_frames_are_put_in_order_and_counted(dump):
    frames = _frames(dump)
    order = [0, 2, 1, 3, 4, 4, 4, *range(8, COUNT)]
    dump.write_bytes(frames[order].tobytes())
    trace = _read(dump)
    assert trace.faults == {"lost_frames": 3, "repeated_frames": 2}
    kept = [0, 1, 2, 3, 4, *range(8, COUNT)]
    assert np.array_equal(trace.position, 7113 + np.array(kept))
    assert np.array_equal(trace.samples, frames["samples"][kept])


def test_damage_is_seen_by_the_checksums_and_a_good_copy_is_preferred(dump):
    frames = _frames(dump)
    damaged = frames.copy()
    damaged["samples"][5, 100] ^= 1
    damaged["samples"][7, 0] ^= 4
    damaged["sample"][9] += 1024  # the header no longer fits its checksum
    dump.write_bytes(np.concatenate([damaged, frames[7:8]]).tobytes())
    trace = _read(dump)
    assert trace.faults == {"damaged_headers": 1, "damaged_frames": 2, "repeated_frames": 1, "lost_frames": 1}
    assert trace.position[~trace.is_intact] - 7113 == [5]


def test_wrong_sample_counts_and_trailing_bytes_are_reported(dump):
    frames = _frames(dump)
    frames["samples_per_frame"][4] = 512
    frames["header_crc"] = header_checksums(frames)
    dump.write_bytes(frames.tobytes() + b"cut off")
    trace = _read(dump)
    assert trace.faults == {"short_frames": 1, "trailing_bytes": 7}
    assert np.sum(~trace.is_intact) == 1


def test_a_trace_may_cross_a_second(tmp_path):
    path = tmp_path / "late.dat"
    samples = np.arange(COUNT * 1024, dtype=np.int64).astype(np.int16)
    start = 200_000_000 - 20 * 1024
    write_frames(path, samples, TraceReference(path, "11", "CS011", 11, 1_311_073_541, start, 200e6), 11)
    assert set(_frames(path)["time"]) == {1_311_073_541, 1_311_073_542}
    trace = _read(path)
    assert trace.faults == {}
    assert np.array_equal(trace.samples.ravel(), samples)


def rewrite(frames, **changes):
    """Frames of other headers, whose checksums are right."""
    for name, value in changes.items():
        frames[name] = value
    frames["header_crc"] = header_checksums(frames)
    return frames


def test_several_receivers_in_one_file_are_several_traces(dump):
    other = rewrite(_frames(dump), rcu=33)
    dump.write_bytes(np.stack([_frames(dump), other], axis=1).tobytes())
    first, second = list_frame_traces(dump)
    assert (first.rcu, second.rcu) == (10, 33)
    assert read_frame_trace(second).faults == {}


def test_other_files_and_subband_frames_are_refused_in_one_sentence(dump, tmp_path):
    noise = tmp_path / "noise.dat"
    noise.write_bytes(np.random.default_rng(2).bytes(3 * FRAME.itemsize))
    with pytest.raises(UnreadableFileError, match="no valid frame header"):
        list_frame_traces(noise)
    noise.write_bytes(b"short")
    with pytest.raises(UnreadableFileError, match="5 bytes"):
        list_frame_traces(noise)
    dump.write_bytes(rewrite(_frames(dump), bands_per_frame=3).tobytes())
    with pytest.raises(BadInputError, match="3 bands"):
        list_frame_traces(dump)


@pytest.mark.shared
def test_every_checksum_of_the_real_dumps_agrees(shared):
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


BLOCKS = 30


@pytest.fixture
def samples() -> NDArray[np.int16]:
    return np.random.default_rng(3).normal(scale=30, size=BLOCKS * 1024).astype(np.int16)


def _write_early(path: Path, samples: NDArray[np.int16]) -> None:
    """As in 2008: attributes are arrays of one, nothing is said of the antenna set."""
    with h5py.File(path, "w") as file:
        file.attrs["TELESCOPE"] = np.array(["LOFAR"], dtype=h5py.string_dtype())
        dataset = file.create_dataset("Station001/001001009", data=samples)
        attributes: dict[str, Any] = {
            "STATION_ID": np.array([1], "u4"),
            "RCU_ID": np.array([9], "u4"),
            "TIME": np.array([1_214_929_202], "u4"),
            "SAMPLE_NUMBER": np.array([126_587_904], "u4"),
            "SAMPLE_FREQUENCY_VALUE": np.array([200.0]),
            "SAMPLE_FREQUENCY_UNIT": np.array(["MHz"], dtype=h5py.string_dtype()),
            "DATA_LENGTH": np.array([samples.size], "u8"),
        }
        for name, value in attributes.items():
            dataset.attrs[name] = value


def _write_documented(path: Path, samples: NDArray[np.int16], **changes: Any) -> None:
    """As in the interface document: scalars, a station's name, the antenna set, flagged ranges."""
    with h5py.File(path, "w") as file:
        file.attrs["ANTENNA_SET"] = "LBA_OUTER"
        group = file.create_group("STATION_CS302")
        group.attrs["STATION_NAME"] = "CS302"
        attributes = {
            "STATION_ID": 142,
            "TIME": 1_400_000_000,
            "SAMPLE_NUMBER": 2048,
            "SAMPLE_FREQUENCY_VALUE": 200e6,
            "SAMPLE_FREQUENCY_UNIT": "Hz",
            "DATA_LENGTH": samples.size,
        } | changes
        for rcu in (4, 5):
            dataset = group.create_dataset(f"DIPOLE_142000{rcu:03d}", data=samples, chunks=(1024,))
            for name, value in (attributes | {"RCU_ID": rcu}).items():
                if value is not None:
                    dataset.attrs[name] = value
        group.create_dataset("NOT_A_DIPOLE", data=samples)


def test_the_layout_of_2008_is_read(tmp_path, samples):
    path = tmp_path / "early.h5"
    _write_early(path, samples)
    (reference,) = list_hdf5_traces(path)
    assert (reference.station, reference.rcu, reference.antenna, reference.dipole) == ("CS001", 9, 4, "Y")
    assert reference.sample_rate_hz == 200e6
    trace = read_hdf5_trace(reference)
    assert trace.faults == {}
    assert np.array_equal(trace.samples.ravel(), samples)
    assert trace.position[0] == 123_621


def test_the_documented_layout_is_read_with_its_antenna_set(tmp_path, samples):
    path = tmp_path / "documented.h5"
    _write_documented(path, samples)
    even, odd = list_hdf5_traces(path)
    assert (even.station, even.rcu, even.dipole, odd.dipole) == ("CS302", 4, "Y", "X")
    assert even.sample_rate_hz == 200e6
    assert list_hdf5_traces(path, "LBA_INNER")[0].dipole == "X"


def test_lost_flagged_and_miscounted_samples_are_reported(tmp_path, samples):
    holed = samples.copy()
    holed[5 * 1024 : 7 * 1024] = 0
    path = tmp_path / "holed.h5"
    _write_documented(
        path,
        np.append(holed, np.int16(1)),
        FLAG_OFFSETS=np.array([[10 * 1024 + 5, 10 * 1024 + 6], [12 * 1024, 14 * 1024]]),
        DATA_LENGTH=samples.size + 500,
    )
    trace = read_hdf5_trace(list_hdf5_traces(path)[0])
    assert trace.faults == {"lost_frames": 2, "flagged_blocks": 3, "missing_samples": 499, "trailing_samples": 1}
    assert np.flatnonzero(~trace.is_intact).tolist() == [5, 6, 10, 12, 13]


def test_missing_attributes_and_strange_content_are_named(tmp_path, samples):
    path = tmp_path / "bad.h5"
    _write_documented(path, samples, TIME=None)
    with pytest.raises(BadInputError, match="TIME"):
        list_hdf5_traces(path)
    _write_documented(path, samples, SAMPLE_FREQUENCY_UNIT="furlong")
    with pytest.raises(BadInputError, match="furlong"):
        list_hdf5_traces(path)
    with h5py.File(path, "w") as file:
        file["Station001/001001009"] = samples.astype(float)
    with pytest.raises(BadInputError, match="integer samples"):
        list_hdf5_traces(path)
    path.write_bytes(b"\x89HDF\r\n\x1a\nnot really")
    with pytest.raises(UnreadableFileError, match="unreadable"):
        list_hdf5_traces(path)


def test_links_out_of_the_file_are_not_followed(tmp_path, samples):
    secret = tmp_path / "secret.h5"
    _write_early(secret, samples)
    path = tmp_path / "linked.h5"
    with h5py.File(path, "w") as file:
        file.create_group("Station001")["001001009"] = h5py.ExternalLink("secret.h5", "Station001/001001009")
    with pytest.raises(UnreadableFileError, match="found none"):
        list_hdf5_traces(path)


@pytest.mark.shared
def test_the_real_file_of_2008_says_what_it_is(shared):
    (reference,) = list_hdf5_traces(shared / "data/tbb/rw_20080701_162002_0109.h5")
    assert (reference.station, reference.rcu, reference.start_s) == ("CS001", 9, 1_214_929_202)  # 2008-07-01 16:20:02
    trace = read_hdf5_trace(reference)
    assert trace.samples.shape == (2000, 1024)
    assert trace.faults == {}


@pytest.mark.long
def test_flipped_bytes_give_a_sentence_or_samples(tmp_path, samples, flip_bytes):
    path = tmp_path / "early.h5"
    _write_early(path, samples)
    structure = slice(0, 1500)  # the samples follow it: any bytes are samples
    imports = "from lbacal_core.traces.trace import list_traces, read_trace"
    read = "[read_trace(reference) for reference in list_traces(Path(name))]"
    outcomes = flip_bytes(path.read_bytes(), 120, imports, read, structure)
    assert {"read", "sentence"} <= set(outcomes) <= {"read", "sentence", "died"}
    assert outcomes.count("died") < 12
