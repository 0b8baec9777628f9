from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.trace import list_hdf5_traces, read_hdf5_trace

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


def test_the_layout_of_2008_is_read(tmp_path: Path, samples: NDArray[np.int16]) -> None:
    path = tmp_path / "early.h5"
    _write_early(path, samples)
    (reference,) = list_hdf5_traces(path)
    assert (reference.station, reference.rcu, reference.antenna, reference.dipole) == ("CS001", 9, 4, "Y")
    assert reference.sample_rate_hz == 200e6
    trace = read_hdf5_trace(reference)
    assert trace.faults == {}
    assert np.array_equal(trace.samples.ravel(), samples)
    assert trace.position[0] == 123_621


def test_the_documented_layout_is_read_with_its_antenna_set(tmp_path: Path, samples: NDArray[np.int16]) -> None:
    path = tmp_path / "documented.h5"
    _write_documented(path, samples)
    even, odd = list_hdf5_traces(path)
    assert (even.station, even.rcu, even.dipole, odd.dipole) == ("CS302", 4, "Y", "X")
    assert even.sample_rate_hz == 200e6
    assert list_hdf5_traces(path, "LBA_INNER")[0].dipole == "X"


def test_lost_flagged_and_miscounted_samples_are_reported(tmp_path: Path, samples: NDArray[np.int16]) -> None:
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


def test_missing_attributes_and_strange_content_are_named(tmp_path: Path, samples: NDArray[np.int16]) -> None:
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


def test_links_out_of_the_file_are_not_followed(tmp_path: Path, samples: NDArray[np.int16]) -> None:
    secret = tmp_path / "secret.h5"
    _write_early(secret, samples)
    path = tmp_path / "linked.h5"
    with h5py.File(path, "w") as file:
        file.create_group("Station001")["001001009"] = h5py.ExternalLink("secret.h5", "Station001/001001009")
    with pytest.raises(UnreadableFileError, match="found none"):
        list_hdf5_traces(path)


@pytest.mark.shared
def test_the_real_file_of_2008_says_what_it_is(shared: Path) -> None:
    (reference,) = list_hdf5_traces(shared / "data/tbb/rw_20080701_162002_0109.h5")
    assert (reference.station, reference.rcu, reference.start_s) == ("CS001", 9, 1_214_929_202)  # 2008-07-01 16:20:02
    trace = read_hdf5_trace(reference)
    assert trace.samples.shape == (2000, 1024)
    assert trace.faults == {}


@pytest.mark.long
def test_flipped_bytes_give_a_sentence_or_samples(
    tmp_path: Path, samples: NDArray[np.int16], flip_bytes: Callable[..., list[str]]
) -> None:
    path = tmp_path / "early.h5"
    _write_early(path, samples)
    structure = slice(0, 1500)  # the samples follow it: any bytes are samples
    imports = "from lbacal_core.traces.trace import list_traces, read_trace"
    read = "[read_trace(reference) for reference in list_traces(Path(name))]"
    outcomes = flip_bytes(path.read_bytes(), 120, imports, read, structure)
    assert {"read", "sentence"} <= set(outcomes) <= {"read", "sentence", "died"}
    assert outcomes.count("died") < 12
