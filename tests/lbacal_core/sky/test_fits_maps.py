from __future__ import annotations

from pathlib import Path

import healpy as hp
import numpy as np
import pytest
from astropy.io import fits

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.sky.names import load_sky

NSIDE = 16
PIXELS = hp.nside2npix(NSIDE)
GALACTIC_CENTRE = (266.405, -28.936)  # ICRS, degrees


def directions(frame: str) -> tuple[np.ndarray, np.ndarray]:
    theta, phi = hp.Rotator(coord=[frame, "C"])(*hp.pix2ang(NSIDE, np.arange(PIXELS)))
    return phi, np.pi / 2 - theta


def blob(frame: str) -> np.ndarray:
    """1000 K, and 5 degrees wide 4000 K more at the Galactic centre."""
    ra, dec = directions(frame)
    centre = hp.ang2vec(*GALACTIC_CENTRE, lonlat=True)
    cosine = hp.ang2vec(np.pi / 2 - dec, ra) @ centre
    return 1000.0 + 4000.0 * np.exp((cosine - 1) / np.radians(10.0) ** 2)


def brightness_at(sky: object, right_ascension_deg: float, declination_deg: float, nu: float = 50.0) -> float:
    values = sky.temperature(np.array([nu]))[0]  # type: ignore[attr-defined]
    lmax = values.shape[0] - 1
    pixels = hp.alm2map(values.T[np.triu_indices(lmax + 1)], 64, lmax=lmax)
    return float(hp.get_interp_val(pixels, right_ascension_deg, declination_deg, lonlat=True))


def write_healpix(path: Path, frame: str, nu: float | None, factor: float = 1.0) -> Path:
    table = fits.BinTableHDU.from_columns([fits.Column("T", "E", array=(factor * blob(frame)).astype("f4"), unit="K")])
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": "RING", "NSIDE": NSIDE, "COORDSYS": frame})
    if nu is not None:
        table.header["FREQ"] = nu
    table.writeto(path)
    return path


def test_one_healpix_fits_map_is_carried_to_other_frequencies_by_a_power_law(tmp_path: Path) -> None:
    sky = load_sky(str(write_healpix(tmp_path / "map.fits", "G", 50e6)))
    assert brightness_at(sky, *GALACTIC_CENTRE) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 86.4, 28.9, nu=25.0) == pytest.approx(1000.0 * 2**2.55, rel=0.02)
    assert "nu^-2.55" in sky.origin


def test_fits_maps_at_several_frequencies_are_interpolated(tmp_path: Path) -> None:
    for nu in (30.0, 50.0, 80.0):
        write_healpix(tmp_path / f"map{nu:g}.fits", "C", nu, (nu / 50.0) ** -2.5)
    sky = load_sky(str(tmp_path))
    assert brightness_at(sky, 86.4, 28.9, nu=65.0) == pytest.approx(1000.0 * 1.3**-2.5, rel=0.02)
    with pytest.raises(BadInputError, match="30 to 80 MHz"):
        sky.temperature(np.array([20.0]))


def test_a_fits_map_without_frequency_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="FREQ"):
        load_sky(str(write_healpix(tmp_path / "map.fits", "G", None)))


def test_a_plate_carree_fits_map_is_read_right_way_round(tmp_path: Path) -> None:
    width, height = 360, 181
    right_ascension = 180.0 - np.arange(width)  # rises to the left, as on the sky
    declination = np.arange(height) - 90.0
    ra, dec = np.meshgrid(np.radians(right_ascension), np.radians(declination))
    cosine = hp.ang2vec(np.pi / 2 - dec.ravel(), ra.ravel()) @ hp.ang2vec(*GALACTIC_CENTRE, lonlat=True)
    image = fits.PrimaryHDU((1000.0 + 4000.0 * np.exp((cosine - 1) / np.radians(10.0) ** 2)).reshape(height, width))
    image.header.update(
        {"CTYPE1": "RA---CAR", "CRPIX1": 181.0, "CRVAL1": 0.0, "CDELT1": -1.0, "CUNIT1": "deg"}
        | {"CTYPE2": "DEC--CAR", "CRPIX2": 91.0, "CRVAL2": 0.0, "CDELT2": 1.0, "CUNIT2": "deg", "FREQ": 50.0}
    )
    image.writeto(tmp_path / "lfmap.fits")
    sky = load_sky(str(tmp_path / "lfmap.fits"))
    assert brightness_at(sky, *GALACTIC_CENTRE) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 180.5, 0.0) == pytest.approx(1000.0, rel=0.02)


def test_a_truncated_fits_map_is_unreadable(tmp_path: Path) -> None:
    path = write_healpix(tmp_path / "map.fits", "G", 50.0)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(UnreadableFileError, match=r"map\.fits: expected a FITS map, found a broken one"):
        load_sky(str(path))


def test_an_empty_folder_is_no_sky(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="found none"):
        load_sky(str(tmp_path))
