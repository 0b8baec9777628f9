from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.readers.average import average
from lbacal_core.readers.open import open_source


def write_table(path: Path, time: str, factor: float) -> None:
    lines = [f"# time: {time}", "# duration_s: 10", "frequency_mhz,0X,0Y,1X"]
    lines += [f"{f},{factor * 1.0},{factor * 2.0},{factor * 3.0}" for f in (40, 41, 42)]
    path.write_text("\n".join(lines))


def test_folder_of_tables_is_read_in_order_of_time(tmp_path: Path) -> None:
    write_table(tmp_path / "b.csv", "2014-05-01T03:00:00Z", 1.0)
    write_table(tmp_path / "a.csv", "2014-05-01T04:00:00Z", 2.0)
    spectra = average(open_source(tmp_path), 60.0).spectra
    assert sorted(set(spectra.event_id.tolist())) == ["20140501T025955", "20140501T035955"]
    row = np.flatnonzero((spectra.antenna == 1) & (spectra.event_id == "20140501T035955"))[0]
    assert spectra.power[row].tolist() == [6.0, 6.0, 6.0]
    assert set(spectra.station.tolist()) == {"ST001"}


def test_archives_hold_the_same_as_tables(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "a.npz", frequency_mhz=np.arange(40.0, 43.0), power=np.ones((2, 3)), antenna=[7, 7],
        dipole=["X", "Y"], time_unix=1.4e9, duration_s=10.0,
    )  # fmt: skip
    spectra = average(open_source(tmp_path / "a.npz", "CS002"), 60.0).spectra
    assert spectra.antenna.tolist() == [7, 7]
    assert spectra.time_unix.tolist() == [1.4e9, 1.4e9]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("0X", "X0", "an antenna and a dipole, such as 17X"),
        ("# time: 2014-05-01T03:00:00Z", "", "a line '# time"),
        ("2014-05-01T03:00:00Z", "yesterday", "an ISO 8601 instant"),
        ("41,1.0", "41,many", "numbers in every column"),
        ("41,1.0,", "41,", "4 columns in every row|numbers in every column"),
        ("frequency_mhz", "MHz", "frequency_mhz and one column a path, or time,antenna"),
    ],
)
def test_table_that_does_not_follow_the_format_is_refused(
    tmp_path: Path, before: str, after: str, message: str
) -> None:
    path = tmp_path / "a.csv"
    write_table(path, "2014-05-01T03:00:00Z", 1.0)
    path.write_text(path.read_text().replace(before, after))
    with pytest.raises(BadInputError, match=message):
        average(open_source(path), 60.0)


def test_file_with_other_channels_is_refused_by_name(tmp_path: Path) -> None:
    write_table(tmp_path / "a.csv", "2014-05-01T03:00:00Z", 1.0)
    write_table(tmp_path / "b.csv", "2014-05-01T04:00:00Z", 1.0)
    (tmp_path / "b.csv").write_text((tmp_path / "b.csv").read_text().replace("\n42,", "\n43,"))
    with pytest.raises(BadInputError, match=r"b.csv.*channels and paths of a.csv"):
        open_source(tmp_path)
