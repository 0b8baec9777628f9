import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from lbacal_core.errors import BadInputError, MissingExtraError, UnreadableFileError
from lbacal_core.sky import maps
from lbacal_core.sky.names import load_sky


def write_components(blob, path: Path, frame: str, **more: object) -> Path:
    ra, dec = blob.directions(frame)
    content = {
        "maps": np.stack([blob.as_map(frame) / 1000.0, np.ones(ra.size)], axis=1),
        "freqs": np.array([20.0, 40.0, 60.0, 90.0, 120.0]),
        "comps": np.stack([np.ones(5), np.zeros(5)], axis=1),
        "sigmas": 1000.0 * (np.array([20.0, 40.0, 60.0, 90.0, 120.0]) / 50.0) ** -2.5,
        "ra": ra % (2 * np.pi),
        "dec": dec,
        "has_cmb": True,
        "has_isotropic": True,
        **more,
    }
    np.savez(path, **{key: value for key, value in content.items() if value is not None})
    return path


@pytest.mark.parametrize("frame", ["G", "C"])
def test_component_maps_are_brought_to_icrs_from_either_frame(tmp_path, frame, blob, brightness_at):
    sky = load_sky(str(write_components(blob, tmp_path / "sky.npz", frame)))
    # 2 %: what pixels of 3.7 degrees and l <= 47 leave of a blob 10 degrees wide.
    assert brightness_at(sky, *blob.centre_deg) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 86.4, 28.9) == pytest.approx(1000.0, rel=0.02)
    assert brightness_at(sky, 86.4, 28.9, nu=25.0) == pytest.approx(1000.0 * 2**2.5, rel=0.02)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda _: {"has_cmb": None}, "has_cmb and has_isotropic"),
        (lambda blob: {"ra": blob.directions("C")[0][::-1]}, "HEALPix pixels in ring order"),
    ],
    ids=["that do not say what they contain", "in another order"],
)
def test_component_maps_of_another_kind_are_refused(tmp_path, blob, change, said):
    with pytest.raises(BadInputError, match=said):
        load_sky(str(write_components(blob, tmp_path / "sky.npz", "C", **change(blob))))


def give_pygdsm(monkeypatch, model):
    module = type(sys)("pygdsm")
    module.GlobalSkyModel = model  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pygdsm", module)


def test_pygdsm_models_are_read_in_galactic_coordinates(monkeypatch, blob, brightness_at):
    class FakeGlobalSkyModel:
        def __init__(self, **settings):
            assert settings == {"freq_unit": "MHz", "include_cmb": False}

        def generate(self, nu):
            return blob.as_map("G") * (nu / 50.0) ** -2.5

    give_pygdsm(monkeypatch, FakeGlobalSkyModel)
    sky = load_sky("pygdsm-gsm2008")
    assert not sky.has_cmb
    assert brightness_at(sky, *blob.centre_deg) == pytest.approx(5000.0, rel=0.02)


def test_pygdsm_without_its_data_says_so(monkeypatch):
    def refuse(**_):
        raise OSError("no network")

    give_pygdsm(monkeypatch, refuse)
    with pytest.raises(UnreadableFileError, match="could not get its data"):
        load_sky("pygdsm-gsm2008")


def test_without_pygdsm_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygdsm", None)
    with pytest.raises(MissingExtraError, match=r"lbacal\[maps\]"):
        load_sky("pygdsm-gsm2008")


def test_maps_with_holes_are_refused(blob):
    holes = blob.as_map("C")
    holes[17] = np.nan
    with pytest.raises(BadInputError, match="pixel 17"):
        maps.multipoles_of_maps(holes[None], "C", "map")


def write_healpix(blob, path: Path, frame: str, nu: float | None, factor: float = 1.0) -> Path:
    kelvin = (factor * blob.as_map(frame)).astype("f4")
    table = fits.BinTableHDU.from_columns([fits.Column("T", "E", array=kelvin, unit="K")])
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": "RING", "NSIDE": blob.nside, "COORDSYS": frame})
    if nu is not None:
        table.header["FREQ"] = nu
    table.writeto(path)
    return path


def test_one_healpix_fits_map_is_carried_to_other_frequencies_by_a_power_law(tmp_path, blob, brightness_at):
    sky = load_sky(str(write_healpix(blob, tmp_path / "map.fits", "G", 50e6)))
    assert brightness_at(sky, *blob.centre_deg) == pytest.approx(5000.0, rel=0.02)
    assert brightness_at(sky, 86.4, 28.9, nu=25.0) == pytest.approx(1000.0 * 2**2.55, rel=0.02)
    assert "nu^-2.55" in sky.origin


def test_fits_maps_at_several_frequencies_are_interpolated(tmp_path, blob, brightness_at):
    for nu in (30.0, 50.0, 80.0):
        write_healpix(blob, tmp_path / f"map{nu:g}.fits", "C", nu, (nu / 50.0) ** -2.5)
    sky = load_sky(str(tmp_path))
    assert brightness_at(sky, 86.4, 28.9, nu=65.0) == pytest.approx(1000.0 * 1.3**-2.5, rel=0.02)
    with pytest.raises(BadInputError, match="30 to 80 MHz"):
        sky.temperature(np.array([20.0]))


def test_a_fits_map_without_frequency_is_refused(tmp_path, blob):
    with pytest.raises(BadInputError, match="FREQ"):
        load_sky(str(write_healpix(blob, tmp_path / "map.fits", "G", None)))


def test_a_plate_carree_fits_map_is_read_right_way_round(tmp_path, blob, brightness_at):
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


def test_a_truncated_fits_map_and_an_empty_folder_are_no_sky(tmp_path, blob):
    with pytest.raises(UnreadableFileError, match="found none"):
        load_sky(str(tmp_path))
    path = write_healpix(blob, tmp_path / "map.fits", "G", 50.0)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(UnreadableFileError, match=r"map\.fits: expected a FITS map, found a broken one"):
        load_sky(str(path))
