from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.readers.open import open_source
from lbacal_core.readers.source import average

TABLE = """# a comment
time, antenna, dipole, duration_s, event_id, flag, env/temperature_c, 50.0, 50.4, 51.2
2014-05-01T03:00:00Z, 1, EW, 10, first, , 7.5, 1.0, 2.0, 3.0
2014-05-01T03:00:00Z, 2, EW, 10, first, , 7.5, 4.0, 5.0,
2014-05-01T03:00:20Z, 1, EW, 10, second, storm, , 9.0, 9.0, 9.0
2014-05-01T03:00:40Z, 1, EW, 30, third, , 9.5, 2.0, 3.0, 4.0
2014-05-01T03:00:40Z, 2, EW, 30, third, , 9.5, 5.0, 6.0, 7.0
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "rows.csv"
    path.write_text(TABLE)
    return path


def test_every_row_is_a_spectrum_of_its_event_with_flag_and_covariates(table):
    found = average(open_source(table, "MIST"), None)
    spectra = found.spectra
    assert list(zip(spectra.event_id.tolist(), spectra.antenna.tolist(), strict=True)) == [
        ("first", 1), ("second", 1), ("third", 1), ("third", 2),
    ]  # fmt: skip
    assert found.spectra_left_out == 1  # antenna 2 lacks a channel of the first event
    assert found.flags == {"storm": 1}
    assert spectra.flag is not None
    assert spectra.flag.tolist() == ["", "storm", "", ""]
    np.testing.assert_array_equal(spectra.environment["temperature_c"], [7.5, np.nan, 9.5, 9.5])
    assert spectra.time_unix[0] == 1398913200.0
    np.testing.assert_allclose(spectra.channel_widths(), [0.4, 0.4, 0.8])
    assert set(spectra.station.tolist()) == {"MIST"}


def test_a_flagged_integration_does_not_count_in_the_mean_of_its_interval(table):
    found = average(open_source(table), 300.0)
    spectra = found.spectra
    assert found.flags == {}
    first = spectra.power[spectra.antenna == 1][0]
    np.testing.assert_allclose(first, (10 * np.array([1.0, 2.0, 3.0]) + 30 * np.array([2.0, 3.0, 4.0])) / 40)
    assert spectra.environment["temperature_c"][0] == pytest.approx((10 * 7.5 + 30 * 9.5) / 40)


def test_a_missing_value_of_a_temperature_is_not_hidden_in_the_mean_of_its_interval(table):
    """Beside eleven of 10 degrees a -999 was a mean of -74, which is possible."""
    table.write_text(TABLE.replace("7.5", "-999"))
    with pytest.raises(BadInputError, match=r"env/temperature_c: .*found -999 in 2014-05-01T03:00:00"):
        average(open_source(table), 300.0)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("antenna, dipole", "aerial, dipole", "no antenna"),
        ("50.4", "gain", "column 'gain': expected a frequency in MHz"),
        ("2014-05-01T03:00:20Z", "2014-05-01T02:00:20Z", "rows in order of time"),
        (", 1, EW, 30", ", one, EW, 30", "antenna: expected a number >= 0 in every row, found 'one'"),
        ("9.0, 9.0, 9.0", "9.0, many, 9.0", "50.4 MHz: expected a number, found 'many'"),
        ("03:00:20Z", "noon", "an ISO 8601 date or instant"),
        (", 51.2", ", 50.4", "a name for every column, each once"),
        (", 50.0, 50.4, 51.2", "", "at least one column that is a frequency"),
    ],
)
def test_a_table_that_does_not_follow_the_format_is_refused_with_its_place(table, before, after, message):
    table.write_text(TABLE.replace(before, after))
    with pytest.raises(BadInputError, match=message):
        average(open_source(table), None)


def write_table(path: Path, time: str, factor: float) -> None:
    lines = [f"# time: {time}", "# duration_s: 10", "frequency_mhz,0X,0Y,1X"]
    lines += [f"{f},{factor * 1.0},{factor * 2.0},{factor * 3.0}" for f in (40, 41, 42)]
    path.write_text("\n".join(lines))


def test_folder_of_tables_is_read_in_order_of_time(tmp_path):
    write_table(tmp_path / "b.csv", "2014-05-01T03:00:00Z", 1.0)
    write_table(tmp_path / "a.csv", "2014-05-01T04:00:00Z", 2.0)
    spectra = average(open_source(tmp_path), 60.0).spectra
    assert sorted(set(spectra.event_id.tolist())) == ["20140501T025955", "20140501T035955"]
    row = np.flatnonzero((spectra.antenna == 1) & (spectra.event_id == "20140501T035955"))[0]
    assert spectra.power[row].tolist() == [6.0, 6.0, 6.0]
    assert set(spectra.station.tolist()) == {"ST001"}


def test_archives_hold_the_same_as_tables(tmp_path):
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
        ("2014-05-01T03:00:00Z", "yesterday", "an ISO 8601 date or instant"),
        ("41,1.0", "41,many", "numbers in every column"),
        ("41,1.0,", "41,", "4 columns in every row|numbers in every column"),
        ("frequency_mhz", "MHz", "frequency_mhz and one column a path, or time,antenna"),
    ],
)
def test_table_that_does_not_follow_the_format_is_refused(tmp_path, before, after, message):
    path = tmp_path / "a.csv"
    write_table(path, "2014-05-01T03:00:00Z", 1.0)
    path.write_text(path.read_text().replace(before, after))
    with pytest.raises(BadInputError, match=message):
        average(open_source(path), 60.0)


def test_file_with_other_channels_is_refused_by_name(tmp_path):
    write_table(tmp_path / "a.csv", "2014-05-01T03:00:00Z", 1.0)
    write_table(tmp_path / "b.csv", "2014-05-01T04:00:00Z", 1.0)
    (tmp_path / "b.csv").write_text((tmp_path / "b.csv").read_text().replace("\n42,", "\n43,"))
    with pytest.raises(BadInputError, match=r"b.csv.*channels and paths of a.csv"):
        open_source(tmp_path)
