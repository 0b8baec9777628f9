from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.readers.open import open_source
from lbacal_core.readers.source import average

MINI_ARRAYS = np.array([0, 2, 55], dtype=np.int16)
SECONDS, SUB_BANDS = 90, 8
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
    return np.random.default_rng(3).uniform(1.0, 2.0, (SECONDS, MINI_ARRAYS.size, 2, SUB_BANDS))


def test_mini_arrays_are_antennas_and_keep_the_names_of_their_polarisations(tmp_path: Path, power: np.ndarray) -> None:
    write_mini_arrays(tmp_path / "a_SST.fits", power, START_JD + np.arange(SECONDS) / 86_400)
    source = open_source(tmp_path / "a_SST.fits")
    spectra = average(source, 60.0).spectra
    assert sorted(set(spectra.antenna.tolist())) == [0, 2, 55]
    assert sorted(set(spectra.dipole.tolist())) == ["NE", "NW"]
    row = np.flatnonzero((spectra.antenna == 55) & (spectra.dipole == "NE"))[0]
    np.testing.assert_allclose(spectra.power[row], power[:60, 2, 1].mean(axis=0), rtol=1e-6)
    assert spectra.time_unix[row] == pytest.approx(1735689600.0 + 30.0, abs=1e-3)
    assert spectra.event_id[row] == "20250101T000000"
    assert any("mini-array of 19" in note for note in source.notes)


def test_instants_that_go_back_and_files_of_another_layout_are_refused(tmp_path: Path, power: np.ndarray) -> None:
    write_mini_arrays(tmp_path / "a.fits", power, START_JD - np.arange(SECONDS) / 86_400)
    with pytest.raises(BadInputError, match="JD: expected instants in order of time"):
        open_source(tmp_path / "a.fits")
    fits.PrimaryHDU(np.ones((3, 3))).writeto(tmp_path / "b.fits")
    with pytest.raises(UnreadableFileError, match=r"b.fits: expected NenuFAR's statistics"):
        open_source(tmp_path / "b.fits")
    write_mini_arrays(tmp_path / "c.fits", power[:, :2], START_JD + np.arange(SECONDS) / 86_400)
    with pytest.raises(BadInputError, match=r"shape \(90, 3, 2, 8\)"):
        open_source(tmp_path / "c.fits")
