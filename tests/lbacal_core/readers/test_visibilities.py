from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lbacal_core.errors import UnreadableFileError
from lbacal_core.readers.average import average
from lbacal_core.readers.open import choose_channels, open_source

pytestmark = pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about headers of old files


@pytest.mark.shared
def test_hera_autocorrelations_are_read_as_the_file_has_them(shared: Path) -> None:
    path = shared / "data" / "other" / "hera_2459122.25108_autos.uvh5"
    source = open_source(path)
    assert source.frequency_mhz.size == 1536
    assert any("-30.72" in note for note in source.notes)
    spectra = average(source, 60.0, choose_channels(source, band_mhz=(50, 200), width_mhz=1.0)).spectra
    assert len(spectra) == 26 * 2
    with h5py.File(path) as file:
        rows = np.asarray(file["Header/ant_1_array"]) == int(spectra.antenna[0])
        frequency = np.ravel(file["Header/freq_array"]) / 1e6
        polarisation = 0 if spectra.dipole[0] == "X" else 1
        flags = np.asarray(file["Data/flags"])[rows, 0, :, polarisation]
        power = np.where(flags, np.nan, np.asarray(file["Data/visdata"])[rows, 0, :, polarisation].real)
    for k in (0, 50, 149):
        inside = (frequency >= spectra.frequency_mhz[k] - 0.5) & (frequency < spectra.frequency_mhz[k] + 0.5)
        assert spectra.power[0, k] == pytest.approx(np.nanmean(power[:, inside]), rel=1e-6)


def test_file_that_is_no_visibilities_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.uvh5").write_bytes(b"no")
    with pytest.raises(UnreadableFileError, match=r"a\.uvh5"):
        open_source(tmp_path / "a.uvh5")
