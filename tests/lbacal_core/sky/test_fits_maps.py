from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.sky.names import load_sky


def write_healpix(blob, path: Path, frame: str, nu: float | None, factor: float = 1.0) -> Path:
    kelvin = (factor * blob.as_map(frame)).astype("f4")
    table = fits.BinTableHDU.from_columns([fits.Column("T", "E", array=kelvin, unit="K")])
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": "RING", "NSIDE": blob.nside, "COORDSYS": frame})
    if nu is not None:
        table.header["FREQ"] = nu
    table.writeto(path)
    return path


def test_one_healpix_fits_map_is_carried_to_other_frequencies_by_a_power_law(
    tmp_path: Path, blob, brightness_at
) -> None:
    sky = load_sky(str(write_healpix(blob, tmp_path / "map.fits", "G", 50e6)))
    assert brightness_at(sky, *blob.centre_deg) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 86.4, 28.9, nu=25.0) == pytest.approx(1000.0 * 2**2.55, rel=0.02)
    assert "nu^-2.55" in sky.origin


def test_fits_maps_at_several_frequencies_are_interpolated(tmp_path: Path, blob, brightness_at) -> None:
    for nu in (30.0, 50.0, 80.0):
        write_healpix(blob, tmp_path / f"map{nu:g}.fits", "C", nu, (nu / 50.0) ** -2.5)
    sky = load_sky(str(tmp_path))
    assert brightness_at(sky, 86.4, 28.9, nu=65.0) == pytest.approx(1000.0 * 1.3**-2.5, rel=0.02)
    with pytest.raises(BadInputError, match="30 to 80 MHz"):
        sky.temperature(np.array([20.0]))


def test_a_fits_map_without_frequency_is_refused(tmp_path: Path, blob) -> None:
    with pytest.raises(BadInputError, match="FREQ"):
        load_sky(str(write_healpix(blob, tmp_path / "map.fits", "G", None)))


def test_a_plate_carree_fits_map_is_read_right_way_round(tmp_path: Path, blob, brightness_at) -> None:
    width, height = 360, 181
    right_ascension = 180.0 - np.arange(width)  # rises to the left, as on the sky
    declination = np.arange(height) - 90.0
    ra, dec = np.meshgrid(np.radians(right_ascension), np.radians(declination))
    image = fits.PrimaryHDU(blob.towards(ra.ravel(), dec.ravel()).reshape(height, width))
    image.header.update(
        {"CTYPE1": "RA---CAR", "CRPIX1": 181.0, "CRVAL1": 0.0, "CDELT1": -1.0, "CUNIT1": "deg"}
        | {"CTYPE2": "DEC--CAR", "CRPIX2": 91.0, "CRVAL2": 0.0, "CDELT2": 1.0, "CUNIT2": "deg", "FREQ": 50.0}
    )
    image.writeto(tmp_path / "lfmap.fits")
    sky = load_sky(str(tmp_path / "lfmap.fits"))
    assert brightness_at(sky, *blob.centre_deg) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 180.5, 0.0) == pytest.approx(1000.0, rel=0.02)


def test_a_truncated_fits_map_is_unreadable(tmp_path: Path, blob) -> None:
    path = write_healpix(blob, tmp_path / "map.fits", "G", 50.0)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(UnreadableFileError, match=r"map\.fits: expected a FITS map, found a broken one"):
        load_sky(str(path))


def test_an_empty_folder_is_no_sky(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="found none"):
        load_sky(str(tmp_path))
