from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from astropy.table import Table

from lbacal.calibration_files import read_calibrations
from lbacal.exports import JONES, write_station_table, write_uvcal
from lbacal.tables import COLUMNS, mean_curve, write_format, write_nuradio
from lbacal_core.curves.galcal import CARRIED, make_head
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.antennas import Site
from lbacal_core.instrument.instrument import load_instrument

ENDINGS = {"ecsv": ".ecsv", "fits": ".fits", "hdf5": ".h5"}


@pytest.mark.parametrize("kind", ENDINGS)
def test_a_file_gives_back_rows_covariances_and_budgets_bit_by_bit(
    tmp_path: Path, calibrations: dict[str, Any], kind: str
) -> None:
    path = tmp_path / f"c{ENDINGS[kind]}"
    calibrations["curves"][1] |= {"flag_reason": "gain by 5 % off: é", "valid": {"from": "2014-01-01", "to": None}}
    path.write_bytes(write_format(kind, calibrations))
    found = read_calibrations(path)
    for before, after in zip(calibrations["curves"], found["curves"], strict=True):
        assert {name: before[name] for name in after} == after
    assert (found["budgets"], found["at"], found["as_of"]) == tuple(calibrations[n] for n in ("budgets", "at", "as_of"))
    assert write_format(kind, found) == path.read_bytes()


def test_the_json_of_an_answer_and_of_a_fit_are_read_too(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(calibrations))
    assert read_calibrations(path)["curves"] == calibrations["curves"]
    # fit.json: nothing of promotion, and curves without values
    bare = [{name: one[name] for name in one if name not in ("factor", "valid", "calibration", "answered_by")}
            for one in calibrations["curves"]]  # fmt: skip
    path.write_text(json.dumps({"status": "converged", "curves": [*bare, {"c": None, "station": "CS003"}]}))
    found = read_calibrations(path)
    assert len(found["curves"]) == 4
    assert found["curves"][0]["valid"] == {"from": None, "to": None}


def test_the_served_hdf5_holds_budgets_of_a_megabyte(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    calibrations["budgets"]["x"] = {"text": "y" * 1_000_000}
    path = tmp_path / "c.h5"
    path.write_bytes(write_format("hdf5", calibrations))
    assert read_calibrations(path)["budgets"] == calibrations["budgets"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("c.txt", b"1", "a name that ends in .ecsv, .fits, .h5, .hdf5, .json, found .txt"),
        ("c.json", b"[]", "a JSON object, found list"),
        ("c.json", b'{"curves": 3}', "a list of curves, found 3"),
        ("c.json", b'{"curves": [{"c": [1], "station": "A", "antenna": 1, "dipole": "X"}]}', "no frequency_mhz"),
        *((f"c.{ending}", b"no such thing \x00\xff", None) for ending in ("json", "ecsv", "fits", "h5")),
    ],
)
def test_what_is_no_calibration_file_is_refused(tmp_path: Path, name: str, content: bytes, said: str | None) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInputError if said else UnreadableFileError, match=said):
        read_calibrations(tmp_path / name)


def test_tables_of_other_kinds_are_refused(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    Table({"a": [1]}).write(tmp_path / "a.ecsv", format="ascii.ecsv")
    with pytest.raises(BadInputError, match="no station, antenna"):
        read_calibrations(tmp_path / "a.ecsv")
    path = tmp_path / "c.h5"
    path.write_bytes(write_format("hdf5", calibrations))
    with h5py.File(path, "a") as root:
        del root.attrs["galcal"]
    with pytest.raises(BadInputError, match="the head of galcal-1"):
        read_calibrations(path)
    with h5py.File(path, "a") as root:
        root.attrs["galcal"] = "{"
    with pytest.raises(UnreadableFileError, match="JSON text"):
        read_calibrations(path)


def test_the_page_names_every_column_and_field_and_its_example_runs(
    repository: Path, tmp_path: Path, calibrations: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (repository / "docs/formats/galcal.md").read_text()
    head = make_head(calibrations)
    (budget,) = calibrations["budgets"].values()
    fields = [*COLUMNS, *head, *CARRIED, *head["covariances"]["CS002 17 X"], *budget, *budget["terms"][0]]
    assert [name for name in fields if f"`{name}`" not in page] == []
    monkeypatch.chdir(tmp_path)
    Path("C.ecsv").write_bytes(write_format("ecsv", calibrations))
    example = page.partition("```python\n")[2].partition("```")[0]
    Path("example.py").write_text(example)
    found = runpy.run_path("example.py")
    # sky 6 % and a slope, own 1 %, statistical 0.4 %: one draw lies within four of them
    assert np.std(found["ln_c"]) < 0.08
    assert found["ln_c"].shape == (51,)


def test_the_one_curve_of_an_array_is_that_of_the_mean_recorded_power(calibrations: dict[str, Any]) -> None:
    text = write_nuradio(mean_curve(calibrations)).decode().splitlines()
    values = np.array([float(line) for line in text if not line.startswith("#")])
    assert values.size == 101
    c = np.array([curve["c"][:50] for curve in calibrations["curves"]])
    # recorded power of the same sky goes with C^-2
    np.testing.assert_allclose(values[30:80] ** -2, np.mean(c**-2.0, axis=0), rtol=1e-12)
    assert np.all(values[:30] == 0)
    assert np.all(values[80:] == 0)
    assert "mean recorded power of 4 curves" in text[0]
    assert "nobody's cable" in text[1]


def test_a_mean_of_other_channels_is_refused(calibrations: dict[str, Any]) -> None:
    calibrations["curves"][1]["frequency_mhz"] = list(range(31, 82))
    with pytest.raises(BadInputError, match="the same channels"):
        mean_curve(calibrations)


@pytest.mark.parametrize("ending", [".calfits", ".calh5"])
def test_pyuvdata_reads_back_c_errors_flags_arms_and_validity(
    tmp_path: Path, calibrations: dict[str, Any], ending: str
) -> None:
    pyuvdata = pytest.importorskip("pyuvdata")
    path = tmp_path / f"c{ending}"
    instrument = replace(load_instrument("lofar-superterp"), sites={"CS002": Site(53.0, 7.0, 10.0)})
    write_uvcal(calibrations, instrument, path)
    found = pyuvdata.UVCal.from_file(path)
    np.testing.assert_allclose(found.telescope.location.lon.deg, 7.0)
    assert (found.gain_convention, found.gain_scale, found.cal_type) == ("multiply", "V^2", "gain")
    np.testing.assert_allclose(found.freq_array, 1e6 * np.arange(30.0, 81.0))
    # the two arms that the file says: pyuvdata calls the azimuth of the arm its angle
    np.testing.assert_allclose(np.degrees(found.telescope.feed_angle[0]), [45.0, 135.0])
    np.testing.assert_allclose(found.time_range, [[2456658.5, 2457023.5]])
    for curve in calibrations["curves"]:
        gain = found.get_gains(curve["antenna"], f"J{curve['dipole'].lower() * 2}")[:, 0]
        flags = found.get_flags(curve["antenna"], f"J{curve['dipole'].lower() * 2}")[:, 0]
        quality = found.get_quality(curve["antenna"], f"J{curve['dipole'].lower() * 2}")[:, 0]
        c = np.array(curve["c"][:50])
        # calfits holds 8-byte floats; nothing is rounded
        np.testing.assert_array_equal(gain[:50], c)
        np.testing.assert_array_equal(flags, [False] * 50 + [True])
        sigma = np.hypot(np.array(curve["c_sigma_stat"][:50]), np.array(curve["c_sigma_sys"][:50]))
        np.testing.assert_allclose(quality[:50], sigma / c, rtol=1e-6)
    assert "budgets" in found.history


def read_station_table(path: Path) -> dict[tuple[int, str], np.ndarray]:
    """C of the 512 sub-bands by (antenna, dipole), V per ADC unit, of a table that `write_station_table` made."""
    with h5py.File(path, "r") as root:
        unit = float(root.attrs["lbacal_unit_v"])
        return {
            (int(name.removeprefix("LBA")), letter): unit * np.abs(root[name][letter.lower()][()])
            for name in root
            for letter in JONES
            if letter.lower() in root[name]
        }


def test_a_station_table_gives_back_c_of_its_sub_bands(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    path = tmp_path / "c.h5"
    write_station_table(calibrations, path)
    found = read_station_table(path)
    assert sorted(found) == [(4, "X"), (4, "Y"), (17, "X"), (17, "Y")]
    mhz = 100.0 / 512 * np.arange(512)
    inside = (mhz >= 30) & (mhz <= 79)
    for curve in calibrations["curves"]:
        expected = np.interp(mhz[inside], curve["frequency_mhz"][:50], curve["c"][:50])
        np.testing.assert_allclose(found[curve["antenna"], curve["dipole"]][inside], expected, rtol=1e-12)
    with h5py.File(path) as root:
        # what a station multiplies with is near 1, and 1 outside the band
        assert np.all(root["LBA17/x"][()][~inside] == 1.0)
        assert 0.3 < np.abs(root["LBA17/x"][()]).min() < np.abs(root["LBA17/x"][()]).max() < 3.0
        assert root["LBA17/x"].dtype == np.complex128
        assert root.attrs["observation_station"] == "CS002"


def test_what_those_programs_cannot_hold_is_refused(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    instrument = load_instrument("lofar-superterp")
    other = json.loads(json.dumps(calibrations))
    other["curves"][0]["station"] = "CS003"
    with pytest.raises(BadInputError, match="one of CS002, CS003"):
        write_station_table(other, tmp_path / "c.h5")
    undated = calibrations | {"at": None}
    with pytest.raises(BadInputError, match="when the data are taken"):
        write_station_table(undated, tmp_path / "c.h5")
    for curve in calibrations["curves"]:
        curve["antenna"] = None
    with pytest.raises(BadInputError, match="nobody's antenna"):
        write_uvcal(calibrations, instrument, tmp_path / "c.calfits")


def test_what_is_in_effect_until_further_notice_is_so_for_a_day_after_it_was_asked_for(
    tmp_path: Path, calibrations: dict[str, Any]
) -> None:
    pyuvdata = pytest.importorskip("pyuvdata")
    for curve in calibrations["curves"]:
        curve["valid"] = {"from": "2014-01-01", "to": None}
    for at, end in (("2014-05-01", 2456778.5 + 1.0), (None, 2456658.5 + 1.0)):
        write_uvcal(calibrations | {"at": at}, load_instrument("lofar-superterp"), tmp_path / f"{at}.calh5")
        found = pyuvdata.UVCal.from_file(tmp_path / f"{at}.calh5")
        np.testing.assert_allclose(found.time_range, [[2456658.5, end]])


def test_two_arms_of_other_letters_become_the_feeds_of_uvcal_in_their_order(
    tmp_path: Path, calibrations: dict[str, Any]
) -> None:
    pyuvdata = pytest.importorskip("pyuvdata")
    instrument = replace(load_instrument("lofar-superterp"), dipole_azimuth_deg={"E": 90.0, "N": 0.0})
    for curve in calibrations["curves"]:
        curve["dipole"] = {"X": "E", "Y": "N"}[curve["dipole"]]
    write_uvcal(calibrations, instrument, tmp_path / "c.calh5")
    found = pyuvdata.UVCal.from_file(tmp_path / "c.calh5")
    np.testing.assert_allclose(np.degrees(found.telescope.feed_angle[0]), [90.0, 0.0])
    assert json.JSONDecoder().raw_decode(found.history)[0]["feeds"] == {"x": "E", "y": "N"}
    for curve in calibrations["curves"]:
        gain = found.get_gains(curve["antenna"], {"E": "Jxx", "N": "Jyy"}[curve["dipole"]])[:, 0]
        np.testing.assert_array_equal(gain[:50], np.array(curve["c"][:50]))
    three = replace(instrument, dipole_azimuth_deg={"A": 0.0, "B": 60.0, "C": 120.0})
    with pytest.raises(BadInputError, match="at most two arms"):
        write_uvcal(calibrations, three, tmp_path / "c.calh5")
