"""Correlator files as the acquisition software of SKA-Low's test stations writes them, made here from its layout."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import lbacal
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.readers.open import open_source
from lbacal_core.readers.source import average

ANTENNAS = 4
BEGIN = 1_639_180_800.0
LENGTH = 2.0


def voltages_of(seed: int, times: int, dead: int | None = None) -> np.ndarray:
    """Voltages of every antenna and polarisation, shape (time, sample, antenna, 2)."""
    rng = np.random.default_rng(seed)
    volts = rng.normal(size=(times, 50, ANTENNAS, 2)) + 1j * rng.normal(size=(times, 50, ANTENNAS, 2))
    volts *= 1.0 + np.arange(2 * ANTENNAS).reshape(ANTENNAS, 2)
    if dead is not None:
        volts[:, :, dead] = 0.0
    return volts


def write_file(path: Path, volts: np.ndarray, channel: int, begin: float = BEGIN, **facts: object) -> np.ndarray:
    """Correlate voltages and write them; the autocorrelations, shape (time, antenna, 2)."""
    rows = []
    for a in range(ANTENNAS):
        for b in range(a, ANTENNAS):
            products = [
                np.mean(volts[:, :, a, p] * volts[:, :, b, q].conj(), axis=1)
                for p, q in ((0, 0), (0, 1), (1, 0), (1, 1))
            ]
            rows.append(np.stack(products, axis=-1))
    data = np.stack(rows, axis=1)[:, None].astype(np.complex64)
    with h5py.File(path, "w") as file:
        root = file.create_dataset("root", (1,), dtype="float16")
        header = {
            "n_antennas": ANTENNAS, "n_pols": 2, "n_baselines": len(rows), "n_stokes": 4, "n_chans": 1, "n_samples": 1,
            "n_blocks": len(data), "channel_id": channel, "tsamp": LENGTH, "ts_start": begin, "data_mode": "burst",
        }  # fmt: skip
        for name, value in (header | facts).items():
            root.attrs[name] = value
        file["correlation_matrix/data"] = data
        file["sample_timestamps/data"] = begin + LENGTH * np.arange(len(data))[:, None]
    return np.mean(np.abs(volts) ** 2, axis=1)


def test_every_path_has_the_power_of_its_voltages_at_the_channel_s_frequency_and_the_middle_of_its_time(tmp_path):
    path = tmp_path / "correlation_burst_100_20211211_00000_0.hdf5"
    expected = write_file(path, voltages_of(1, 5, dead=2), 100)
    spectra = average(open_source(path, "EDA2"), None).spectra
    assert spectra.frequency_mhz.tolist() == [78.125]
    assert set(spectra.antenna.tolist()) == {0, 1, 3}
    assert set(spectra.station.tolist()) == {"EDA2"}
    for a, dipole, time, power in zip(spectra.antenna, spectra.dipole, spectra.time_unix, spectra.power, strict=True):
        row = round((time - BEGIN - LENGTH / 2) / LENGTH)
        assert time == pytest.approx(BEGIN + LENGTH * row + LENGTH / 2)
        assert power[0] == pytest.approx(expected[row, a, "XY".index(dipole)], rel=1e-6)


def test_a_folder_with_a_channel_a_file_becomes_spectra_of_all_channels(tmp_path):
    expected = {}
    for k, channel in enumerate((66, 64, 65)):
        begin = BEGIN + 10.0 * k
        volts = voltages_of(channel, 3)
        expected[channel] = write_file(tmp_path / f"correlation_burst_{channel}_0.hdf5", volts, channel, begin)
    spectra = lbacal.import_data(tmp_path, average=60)
    assert spectra.frequency_mhz.tolist() == [50.0, 50.78125, 51.5625]
    assert len(spectra) == 2 * ANTENNAS
    assert "the data do not say where the arms point: the instrument's azimuths are taken for them" in spectra.notes
    for a, dipole, power in zip(spectra.antenna, spectra.dipole, spectra.power, strict=True):
        for k, channel in enumerate((64, 65, 66)):
            assert power[k] == pytest.approx(expected[channel][:, a, "XY".index(dipole)].mean(), rel=1e-6)


def test_a_file_whose_autocorrelations_are_not_where_they_belong_is_refused(tmp_path):
    path = tmp_path / "a.hdf5"
    write_file(path, voltages_of(1, 1), 100)
    with h5py.File(path, "r+") as file:
        file["correlation_matrix/data"][...] = file["correlation_matrix/data"][()][:, :, ::-1]
    with pytest.raises(BadInputError, match=r"4 autocorrelations.*found 4 baselines with real XX and YY, 2 of them"):
        open_source(path)


@pytest.mark.parametrize(
    ("facts", "message"), [({"n_antennas": 5}, r"shape \(1, 1, 15, 4\)"), ({"tsamp": 0.0}, "seconds > 0")]
)
def test_a_file_that_contradicts_itself_is_refused(tmp_path, facts, message):
    write_file(tmp_path / "a.hdf5", voltages_of(1, 1), 100, **facts)
    with pytest.raises(BadInputError, match=message):
        open_source(tmp_path / "a.hdf5")


def test_files_of_two_stations_and_a_file_without_header_are_refused(tmp_path):
    write_file(tmp_path / "a.hdf5", voltages_of(1, 1), 100)
    with h5py.File(tmp_path / "b.hdf5", "w") as file:
        file["correlation_matrix/data"] = np.ones((1, 1, 1, 4), complex)
        file["sample_timestamps/data"] = [[BEGIN]]
        file.create_dataset("root", (1,), dtype="f4").attrs.update({"n_antennas": 1, "channel_id": 64, "tsamp": LENGTH})
    with pytest.raises(BadInputError, match="files of one station, found 1 and 4 antennas"):
        open_source(tmp_path)
    with h5py.File(tmp_path / "b.hdf5", "r+") as file:
        del file["root"]
    with pytest.raises(UnreadableFileError, match="a file of the correlator"):
        open_source(tmp_path / "b.hdf5")
