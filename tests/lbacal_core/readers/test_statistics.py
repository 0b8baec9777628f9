from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.io import fits

import lbacal
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.readers import statistics
from lbacal_core.readers.open import open_source
from lbacal_core.readers.source import average

ANTENNAS = 4
SECONDS = 5


def write_statistics(path: Path, **attributes: object) -> np.ndarray:
    """A file as lofar-stingray 1.0.8 lays it out: one float32 dataset (input, sub-band) a second."""
    rng = np.random.default_rng(1)
    sums = rng.uniform(1e6, 2e6, (SECONDS, 2 * ANTENNAS, 512)).astype(np.float32)
    header = {
        "station_name": "CS001",
        "writer_version": "1.0.8",
        "data_type": "SST",
        "antenna_field": "lba",
        "antenna_names": [f"LBA{k:02d}" for k in range(ANTENNAS)],
        "antenna_status": ["OK", "BROKEN", "OK", "SUSPICIOUS"],
        "antenna_usage_mask": [True, True, True, True],
        "antenna_to_sdp_mapping": [[0, k] for k in range(ANTENNAS)],
        "rcu_pcb_id": [1000, 1001, 1002],
    } | attributes
    with h5py.File(path, "w") as file:
        for name, value in header.items():
            file.attrs[name] = value
        for second in range(SECONDS):
            dataset = file.create_dataset(f"SST_2025-03-01T12:00:0{second}.000", data=sums[second])
            dataset.attrs["timestamp"] = f"2025-03-01T12:00:0{second}.000000+00:00"
            dataset.attrs["integration_time"] = 1.0
            dataset.attrs["clock"] = 200e6
            dataset.attrs["frequencies"] = np.arange(512) * 200e6 / 1024
    return sums


def test_station_statistics_become_spectra_of_the_antennas_in_use(tmp_path):
    sums = write_statistics(tmp_path / "sst.h5")
    source = open_source(tmp_path / "sst.h5")
    spectra = average(source, 60.0).spectra
    assert sorted(set(spectra.antenna.tolist())) == [0, 2, 3]
    assert any("LBA01" in note for note in source.notes)
    row = np.flatnonzero((spectra.antenna == 2) & (spectra.dipole == "Y"))[0]
    np.testing.assert_allclose(spectra.power[row], sums[:, 5, 1:].mean(axis=0), rtol=1e-6)
    assert spectra.station[row] == "CS001"
    assert spectra.time_unix[row] == pytest.approx(1740830400.0 + SECONDS / 2)
    assert spectra.width_mhz is not None
    np.testing.assert_allclose(spectra.width_mhz, 0.1953125)


def test_usage_mask_and_mapping_decide_which_input_is_which_antenna(tmp_path):
    sums = write_statistics(
        tmp_path / "sst.h5",
        antenna_status=["OK"] * ANTENNAS,
        antenna_usage_mask=[False, True, True, True],
        antenna_to_sdp_mapping=[[0, 3], [0, 2], [0, 0], [-1, -1]],
    )
    spectra = average(open_source(tmp_path / "sst.h5"), 60.0).spectra
    assert sorted(set(spectra.antenna.tolist())) == [1, 2]
    row = np.flatnonzero((spectra.antenna == 1) & (spectra.dipole == "X"))[0]
    np.testing.assert_allclose(spectra.power[row], sums[:, 4, 1:].mean(axis=0), rtol=1e-6)


def test_statistics_of_beamlets_are_refused(tmp_path):
    write_statistics(tmp_path / "bst.h5", data_type="BST")
    with pytest.raises(BadInputError, match="SST"):
        open_source(tmp_path / "bst.h5")


def test_statistics_without_an_antenna_in_use_and_a_damaged_file_are_refused(tmp_path):
    write_statistics(tmp_path / "off.h5", antenna_status=["OFF"] * ANTENNAS)
    with pytest.raises(BadInputError, match="at least one antenna in use, found none"):
        open_source(tmp_path / "off.h5")
    (tmp_path / "half.h5").write_bytes((tmp_path / "off.h5").read_bytes()[:3000])
    with pytest.raises(UnreadableFileError, match=r"half\.h5: expected sub-band statistics \(HDF5\)"):
        statistics.open_statistics(tmp_path / "half.h5")


def test_a_second_without_its_timestamp_is_refused_by_name(tmp_path):
    write_statistics(tmp_path / "sst.h5")
    with h5py.File(tmp_path / "sst.h5", "a") as file:
        del file["SST_2025-03-01T12:00:02.000"].attrs["timestamp"]
    with pytest.raises(UnreadableFileError, match=r"12:00:02.000: expected statistics with timestamp"):
        average(open_source(tmp_path / "sst.h5"), 60.0)


def test_receiver_files_of_the_first_lofar_are_one_source(tmp_path):
    rng = np.random.default_rng(2)
    power = rng.uniform(1.0, 2.0, (4, 90, 512))
    for rcu in range(4):
        power[rcu].astype("<f8").tofile(tmp_path / f"20140501_030405_sst_rcu{rcu:03d}.dat")
    spectra = average(open_source(tmp_path, "CS002"), 60.0).spectra
    assert len(spectra) == 8
    row = np.flatnonzero((spectra.antenna == 1) & (spectra.dipole == "Y") & (spectra.event_id == "20140501T030505"))[0]
    np.testing.assert_allclose(spectra.power[row], power[3, 60:, 1:].mean(axis=0), rtol=1e-12)
    assert spectra.frequency_mhz[0] == pytest.approx(100 / 512)


def test_memory_does_not_grow_with_the_seconds_of_a_file(tmp_path, monkeypatch):
    """HDF5 kept 5 KiB of every second until the file was closed: it is closed between blocks, and can be written to."""
    monkeypatch.setattr(statistics, "AT_ONCE", 2)
    sums = write_statistics(tmp_path / "sst.h5")
    blocks = open_source(tmp_path / "sst.h5").read()
    first = next(blocks)
    with h5py.File(tmp_path / "sst.h5", "r+") as file:
        file.attrs["writer_version"] = "1.0.9"
    assert [len(one.power) for one in (first, *blocks)] == [2, 2, 1]
    np.testing.assert_allclose(first.power[1, 0], sums[1, 0, 1:])


MINI_ARRAYS = np.array([0, 2, 55], dtype=np.int16)
INSTANTS, SUB_BANDS = 90, 8
START_JD = 2460676.5  # 2025-01-01


def write_mini_arrays(path: Path, power: np.ndarray, jd: np.ndarray) -> None:
    """The extensions that nenupy 2.8.5 reads: 1 with frq, noMROn and spol, 7 with JD and data."""
    facts = fits.BinTableHDU.from_columns(
        [
            fits.Column("frq", f"{SUB_BANDS}D", array=[40.0 + 0.1953125 * np.arange(SUB_BANDS)]),
            fits.Column("noMROn", f"{MINI_ARRAYS.size}I", array=[MINI_ARRAYS]),
            fits.Column("spol", "4A2", dim="(2,2)", array=[["NW", "NE"]]),
        ]
    )
    shape = power.shape[1:]
    rows = fits.BinTableHDU.from_columns(
        [
            fits.Column("JD", "D", array=jd),
            fits.Column("data", f"{np.prod(shape)}E", dim=str(shape[::-1]), array=power.astype(np.float32)),
        ]
    )
    others = [fits.BinTableHDU.from_columns([fits.Column("x", "D", array=[0.0])]) for _ in range(5)]
    fits.HDUList([fits.PrimaryHDU(), facts, *others, rows]).writeto(path)


@pytest.fixture
def power() -> np.ndarray:
    return np.random.default_rng(3).uniform(1.0, 2.0, (INSTANTS, MINI_ARRAYS.size, 2, SUB_BANDS))


def test_arms_of_mini_arrays_are_compared_with_those_of_the_instrument(tmp_path, power):
    write_mini_arrays(tmp_path / "a.fits", power, START_JD + np.arange(INSTANTS) / 86_400)
    at = lbacal.Site(47.4, 2.2)
    for azimuth, is_right in ((135, True), (315, True), (100, False)):
        antenna = lbacal.Antenna("short-dipole", {"NE": 45, "NW": azimuth})
        instrument = lbacal.Instrument("mine", at, antenna, lbacal.Chain(), [40.2, 40.8], antennas=[0, 2, 55])
        if is_right:
            assert lbacal.import_data(tmp_path / "a.fits", 60, instrument).arms_deg == {"NE": 45.0, "NW": 135.0}
        else:
            with pytest.raises(BadInputError, match=r"arm of NW: expected 100 deg.*found 135 deg"):
                lbacal.import_data(tmp_path / "a.fits", 60, instrument)


def test_mini_arrays_are_antennas_and_keep_the_names_of_their_polarisations(tmp_path, power):
    write_mini_arrays(tmp_path / "a_SST.fits", power, START_JD + np.arange(INSTANTS) / 86_400)
    source = open_source(tmp_path / "a_SST.fits")
    spectra = average(source, 60.0).spectra
    assert sorted(set(spectra.antenna.tolist())) == [0, 2, 55]
    assert sorted(set(spectra.dipole.tolist())) == ["NE", "NW"]
    row = np.flatnonzero((spectra.antenna == 55) & (spectra.dipole == "NE"))[0]
    np.testing.assert_allclose(spectra.power[row], power[:60, 2, 1].mean(axis=0), rtol=1e-6)
    assert spectra.time_unix[row] == pytest.approx(1735689600.0 + 30.0, abs=1e-3)
    assert spectra.event_id[row] == "20250101T000000"
    assert any("mini-array of 19" in note for note in source.notes)


def test_instants_that_go_back_and_files_of_another_layout_are_refused(tmp_path, power):
    write_mini_arrays(tmp_path / "a.fits", power, START_JD - np.arange(INSTANTS) / 86_400)
    with pytest.raises(BadInputError, match="JD: expected instants in order of time"):
        open_source(tmp_path / "a.fits")
    fits.PrimaryHDU(np.ones((3, 3))).writeto(tmp_path / "b.fits")
    with pytest.raises(UnreadableFileError, match=r"b.fits: expected NenuFAR's statistics"):
        open_source(tmp_path / "b.fits")
    write_mini_arrays(tmp_path / "c.fits", power[:, :2], START_JD + np.arange(INSTANTS) / 86_400)
    with pytest.raises(BadInputError, match=r"shape \(90, 3, 2, 8\)"):
        open_source(tmp_path / "c.fits")
