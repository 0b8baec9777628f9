"""Antenna models of pyuvdata."""

import warnings

import numpy as np
import pytest

from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError, UnreadableFileError

pyuvdata = pytest.importorskip("pyuvdata")


def write(one, path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beam = pyuvdata.UVBeam.new(
            telescope_name="x", data_normalization="physical", freq_array=one.frequency_mhz * 1e6, feed_name="dipole",
            feed_version="1", model_name="short", model_version="1", feed_array=["x"], feed_angle=[0.3],
            mount_type="fixed", pixel_coordinate_system="az_za", axis1_array=np.radians(one.phi_deg),
            axis2_array=np.radians(one.zenith_deg), data_array=np.stack([one.phi, one.theta])[:, None], history="",
        )  # fmt: skip
        beam.write_beamfits(str(path), run_check=False)
    return path


def test_a_dipole_comes_back_without_a_level(tabulated, tmp_path):
    table = load_antenna(str(write(tabulated, tmp_path / "dipole.beamfits")))
    tabulated.require_the_same(table)
    assert not table.has_level


def test_another_file_and_a_beam_of_power_are_refused(tabulated, tmp_path):
    (tmp_path / "no.fits").write_text("nothing of the kind")
    with pytest.raises(UnreadableFileError, match="expected a BeamFITS file"):
        load_antenna(str(tmp_path / "no.fits"))
    path = write(tabulated, tmp_path / "dipole.fits")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beam = pyuvdata.UVBeam.from_file(str(path))
        beam.efield_to_power()
        beam.write_beamfits(str(tmp_path / "power.fits"))
    with pytest.raises(BadInputError, match="found a power beam on az_za"):
        load_antenna(str(tmp_path / "power.fits"))
