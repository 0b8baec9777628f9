from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lbacal.exports import read_station_table, write_station_table, write_uvcal
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import Site
from lbacal_core.instrument.instrument import load_instrument


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
    write_station_table(other, tmp_path / "c.h5", "CS003")
    undated = calibrations | {"at": None}
    with pytest.raises(BadInputError, match="when the data are taken"):
        write_station_table(undated, tmp_path / "c.h5")
    for curve in calibrations["curves"]:
        curve["antenna"] = None
    with pytest.raises(BadInputError, match="nobody's antenna"):
        write_uvcal(calibrations, instrument, tmp_path / "c.calfits")


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
