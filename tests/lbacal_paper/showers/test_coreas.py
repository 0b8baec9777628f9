from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_paper.showers.coreas import read_coreas, sky_basis


def test_axes_become_east_north_up_in_si(hdf5_shower: Path) -> None:
    shower = read_coreas(hdf5_shower)
    # x points north, y to the west
    assert shower.position_m == pytest.approx(np.array([[0, 100, 7], [-200, 0, 7], [50, -50, 7]]))
    strongest = shower.field[np.arange(3), 500]
    assert strongest == pytest.approx(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-9)
    assert shower.energy_ev == 1e17


def test_a_shower_that_moves_north_comes_from_the_south(hdf5_shower: Path) -> None:
    shower = read_coreas(hdf5_shower)
    assert (shower.zenith_deg, shower.azimuth_deg) == (60.0, 180.0)
    # from the south at 60 deg: zenith angle grows to the south and down, azimuth grows to the west
    assert sky_basis(60.0, 180.0) == pytest.approx(np.array([[0, -0.5, -np.sqrt(0.75)], [-1, 0, 0]]), abs=1e-12)
    on_sky = shower.on_sky()[np.arange(3), 500]
    assert on_sky == pytest.approx(np.array([[-0.5, 0], [0, 1], [-np.sqrt(0.75), 0]]), abs=1e-9)


def test_text_files_and_hdf5_give_the_same_shower(hdf5_shower: Path, reas_shower: Path) -> None:
    one, other = read_coreas(hdf5_shower), read_coreas(reas_shower)
    assert other.field == pytest.approx(one.field, rel=1e-6)
    assert other.position_m == pytest.approx(one.position_m)
    assert (other.zenith_deg, other.azimuth_deg, other.energy_ev) == (60.0, 180.0, 1e17)


def test_broken_showers_are_refused_by_name(hdf5_shower: Path, reas_shower: Path, tmp_path: Path) -> None:
    (tmp_path / "no.hdf5").write_text("no")
    with pytest.raises(UnreadableFileError, match=r"no\.hdf5"):
        read_coreas(tmp_path / "no.hdf5")
    (tmp_path / "SIM2_coreas/raw_a1.dat").unlink()
    with pytest.raises(UnreadableFileError, match="raw_a1"):
        read_coreas(reas_shower)
    reas_shower.write_text("ShowerZenithAngle = 60\n")
    with pytest.raises(BadInputError, match="ShowerAzimuthAngle"):
        read_coreas(reas_shower)
    shower = read_coreas(hdf5_shower)
    with pytest.raises(BadInputError, match="time"):
        replace(shower, time_s=shower.time_s**2)


def test_the_field_of_a_real_shower_is_transverse() -> None:
    """The examples of the PyPI package nuradiomc: a wrong axis or angle would leave a field along the line of sight."""
    package = importlib.util.find_spec("NuRadioReco")
    if package is None or package.origin is None:
        pytest.skip("needs the PyPI package nuradiomc, which is no dependency")
    folder = Path(package.origin).parent / "examples/example_data"
    for name in ("example_data.hdf5", "example_event.h5", "greenland_starshape_32obs.hdf5"):
        shower = read_coreas(folder / name)
        zenith, azimuth = np.radians([shower.zenith_deg, shower.azimuth_deg])
        towards = np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])
        # the wave front is curved by a degree or two
        assert np.abs(shower.field @ towards).max() < 0.03 * np.abs(shower.field).max()
