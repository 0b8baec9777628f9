import h5py
import numpy as np
import pytest
from astropy.coordinates import EarthLocation

from lbacal_core.errors import UnreadableFileError
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import average

pytestmark = pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about headers of old files


@pytest.mark.long
@pytest.mark.shared
def test_hera_autocorrelations_are_read_as_the_file_has_them(shared):
    path = shared / "data" / "other" / "hera_2459122.25108_autos.uvh5"
    source = open_source(path)
    assert source.frequency_mhz.size == 1536
    assert any("-30.72" in note for note in source.notes)
    spectra = average(source, 60.0, choose_channels(source, band_mhz=(50, 200), width_mhz=1.0)).spectra
    assert len(spectra) == 26 * 2
    assert spectra.arms_deg == {"X": 0.0, "Y": 90.0}  # its header says `x_orientation` NORTH
    with h5py.File(path) as file:
        rows = np.asarray(file["Header/ant_1_array"]) == int(spectra.antenna[0])
        frequency = np.ravel(file["Header/freq_array"]) / 1e6
        polarisation = 0 if spectra.dipole[0] == "X" else 1
        flags = np.asarray(file["Data/flags"])[rows, 0, :, polarisation]
        power = np.where(flags, np.nan, np.asarray(file["Data/visdata"])[rows, 0, :, polarisation].real)
    for k in (0, 50, 149):
        inside = (frequency >= spectra.frequency_mhz[k] - 0.5) & (frequency < spectra.frequency_mhz[k] + 0.5)
        assert spectra.power[0, k] == pytest.approx(np.nanmean(power[:, inside]), rel=1e-6)


def test_file_that_is_no_visibilities_is_refused(tmp_path):
    (tmp_path / "a.uvh5").write_bytes(b"no")
    with pytest.raises(UnreadableFileError, match=r"a\.uvh5"):
        open_source(tmp_path / "a.uvh5")


@pytest.mark.parametrize("suffix", ["uvh5", "uvfits"])
def test_autocorrelations_of_both_formats_are_read_with_their_flags(tmp_path, suffix):
    from pyuvdata import Telescope, UVData

    location = EarthLocation.from_geodetic(21.4, -30.7, 1050.0)
    positions = {k: np.array([14.0 * k, 0.0, 0.0]) for k in range(3)}
    data = UVData.new(
        freq_array=100e6 + 4e5 * np.arange(6),
        polarization_array=np.array([-5, -6]),
        times=2459122.25 + np.arange(4) * 10 / 86_400,
        telescope=Telescope.new(
            location=location, name="made", instrument="made", antenna_positions=positions, x_orientation="east",
            feeds=["x", "y"], mount_type="fixed",
        ),
        antpairs=[(0, 0), (1, 1), (2, 2), (0, 1)],
        integration_time=10.0,
        channel_width=4e5,
        empty=True,
        do_blt_outer=True,
    )  # fmt: skip
    data.data_array[...] = 2.0 + data.ant_1_array[:, None, None]
    data.data_array[..., 1] *= 10.0
    data.flag_array[...] = False
    data.flag_array[data.ant_1_array == 1, 1:5, 0] = True
    path = tmp_path / f"a.{suffix}"
    if suffix == "uvh5":
        data.write_uvh5(path)
    else:
        data.phase_to_time(data.time_array[0])
        data.write_uvfits(path)
    source = open_source(path)
    assert source.arms_deg == {"X": 90.0, "Y": 0.0}
    np.testing.assert_allclose(source.frequency_mhz, 100.0 + 0.4 * np.arange(6))
    np.testing.assert_allclose(source.width_mhz, 0.4)
    paths = list(zip(source.station.tolist(), source.antenna.tolist(), source.dipole.tolist(), strict=True))
    assert paths == [("made", antenna, dipole) for antenna in range(3) for dipole in "XY"]
    spectra = average(source, None, choose_channels(source, width_mhz=0.8)).spectra
    assert len(set(spectra.event_id.tolist())) == 4
    levels = {(int(a), str(d)): p[0] for a, d, p in zip(spectra.antenna, spectra.dipole, spectra.power, strict=True)}
    expected = {(a, d): (2.0 + a) * (10.0 if d == "Y" else 1.0) for a in range(3) for d in "XY" if (a, d) != (1, "X")}
    assert levels == pytest.approx(expected)
