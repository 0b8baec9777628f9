"""What `hdf5` refuses is tested where it is used: `test_spectra.py` has every wrong type, link, filter and storage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.hdf5 import FLOATS, INTEGERS, NUMBERS, STRINGS, Kind, is_in_file, open_dataset, read_values
from lbacal_core.spectra.spectra import Spectra, read_columns, read_spectra, write_spectra


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (STRINGS, ["CS002", "CS003", "CS002", "e\u0301t\u00e9"]),
        (INTEGERS, np.array([3, 1, 2], dtype=">i2")),
        (NUMBERS, np.array([3, 1, 2], dtype="u1")),
        (FLOATS, np.array([0.1, np.nan, np.inf])),
    ],
)
def test_values_are_read_as_their_kind_says(tmp_path: Path, kind: Kind, values: object) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = values
        read = read_values(open_dataset(file, "a", kind, "a"), kind, "a")
    np.testing.assert_array_equal(read, np.asarray(values))
    assert np.issubdtype(read.dtype, kind.read_as)


def test_the_first_row_of_a_text_that_is_none_is_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.array([b"good", b"\xff", b"good", b"\xff"])
        with pytest.raises(BadInputError, match="a, row 1: expected UTF-8 text"):
            read_values(open_dataset(file, "a", STRINGS, "a"), STRINGS, "a")


def test_a_link_is_seen_without_being_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["here"] = 1.0
        file["elsewhere"] = h5py.ExternalLink("none.h5", "/a")
        file["nowhere"] = h5py.SoftLink("/none")
        assert [is_in_file(file, name) for name in ("here", "elsewhere", "nowhere")] == [True, False, False]


def test_powers_of_four_bytes_are_read_as_the_numbers_that_they_are(two_stations: Spectra, tmp_path: Path) -> None:
    write_spectra(two_stations, tmp_path / "s.h5")
    with h5py.File(tmp_path / "s.h5", "a") as file:
        del file["power"]
        file["power"] = two_stations.power.astype("f4")
    assert np.array_equal(read_spectra(tmp_path / "s.h5").power, two_stations.power.astype("f4").astype("f8"))


def test_flagged_spectra_stay_in_the_file_and_are_left_out_when_read(two_stations: Spectra, tmp_path: Path) -> None:
    rows = len(two_stations)
    flag = np.full(rows, "", dtype="U5")
    flag[[2, 5]] = "storm"
    write_spectra(replace(two_stations, flag=flag), tmp_path / "s.h5")
    with h5py.File(tmp_path / "s.h5") as file:
        assert len(file["power"]) == rows
    read = read_spectra(tmp_path / "s.h5")
    assert (read.left_out, read.flag) == ({"storm": 2}, None)
    assert read.digest() == two_stations.select(flag == "").digest()
    with pytest.raises(BadInputError, match=r"flag, row 2: expected no flagged spectra"):
        read_columns((tmp_path / "s.h5").read_bytes(), "body", 1 << 30)
    write_spectra(replace(two_stations, flag=np.full(rows, "storm")), tmp_path / "s.h5")
    with pytest.raises(BadInputError, match=f"flag: expected a spectrum that is not flagged, found all {rows} are"):
        read_spectra(tmp_path / "s.h5")
