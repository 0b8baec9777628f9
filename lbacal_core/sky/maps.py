"""Sky models from HEALPix maps: files of principal components, and the package pygdsm."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lbacal_core.errors import BadInputError, UnknownNameError, needing, reading
from lbacal_core.foreign import read_npz
from lbacal_core.grids import Floats
from lbacal_core.sky.model import Complexes, SkyModel

LMAX = 48
"""Multipoles kept of a map: higher ones change P_sky by less than 1e-5."""

SYNCHROTRON_INDEX = 2.55
"""T ~ nu^-index for a map that comes at one frequency only (mean of 30-80 MHz in the Global Sky Model)."""

SINGLE_MAP_NODES_MHZ = np.array([10.0, 20.0, 40.0, 80.0, 120.0])

# (has_cmb, has_isotropic) of component files without these fields. pygdsm subtracts the CMB from LFSM and
# not from GSM of 2008, so the one contains it and the other does not; both rest on total-power maps, which contain
# the isotropic extragalactic part.
KNOWN_COMPONENT_FILES = {"gsm-408locked": (False, True), "lfsm-5.1deg": (True, True)}

PYGDSM_NAMES = ("pygdsm-gsm2008", "pygdsm-gsm2016", "pygdsm-lfsm", "pygdsm-haslam")
PYGDSM_NODES_MHZ = np.arange(25.0, 101.0, 5.0)


def read_component_maps(path: Path) -> SkyModel:
    """Read a file of principal components (docs/formats/sky-models.md): the layout that the PyPI package lsl ships.

    Arrays `maps` (pixel, component), `freqs` (node,) in MHz, `comps` (node, component), `sigmas` (node,) in K,
    `ra` and `dec` (pixel,) in rad of each pixel, and optionally `has_cmb` and `has_isotropic`.
    """
    content = read_npz(path, ("maps", "freqs", "comps", "sigmas", "ra", "dec"), "component maps")
    maps = np.asarray(content["maps"], dtype=float)
    if maps.ndim != 2:
        raise BadInputError(f"{path}: maps", "shape (pixel, component)", f"{maps.shape}")
    if "has_cmb" in content and "has_isotropic" in content:
        has_cmb, has_isotropic = bool(content["has_cmb"]), bool(content["has_isotropic"])
    elif path.stem in KNOWN_COMPONENT_FILES:
        has_cmb, has_isotropic = KNOWN_COMPONENT_FILES[path.stem]
    else:
        raise BadInputError(str(path), "has_cmb and has_isotropic, which say what the maps contain", "neither")
    frame = _frame_of_pixels(content["ra"], content["dec"], maps.shape[0], str(path))
    return SkyModel(
        name=path.stem,
        frequency_mhz=np.asarray(content["freqs"], dtype=float),
        level=np.asarray(content["sigmas"], dtype=float),
        weight=np.asarray(content["comps"], dtype=float),
        multipoles=multipoles_of_maps(maps.T, frame, str(path)),
        has_cmb=has_cmb,
        has_isotropic=has_isotropic,
        origin=path.name,
    )


def make_pygdsm_model(name: str) -> SkyModel:
    """Make a model from the package pygdsm (extra `maps`), which fetches its data by itself on first use."""
    with needing(f"sky {name}", "maps"):
        import pygdsm
    makers = {
        "pygdsm-gsm2008": lambda: pygdsm.GlobalSkyModel(freq_unit="MHz", include_cmb=False),
        "pygdsm-gsm2016": lambda: pygdsm.GlobalSkyModel16(freq_unit="MHz", data_unit="TRJ", include_cmb=False),
        "pygdsm-lfsm": lambda: pygdsm.LowFrequencySkyModel(freq_unit="MHz", include_cmb=False),
        "pygdsm-haslam": lambda: pygdsm.HaslamSkyModel(freq_unit="MHz", include_cmb=False),
    }
    if name not in makers:
        raise UnknownNameError("sky model", name, sorted(makers))
    with reading(f"sky {name}: pygdsm could not get its data", OSError, RuntimeError):
        maps = np.array([makers[name]().generate(nu) for nu in PYGDSM_NODES_MHZ])
    multipoles = multipoles_of_maps(maps, "G", name)
    return model_of_maps(name, PYGDSM_NODES_MHZ, multipoles, has_cmb=False, has_isotropic=True, origin=name)


def model_of_maps(
    name: str, frequency_mhz: Floats, multipoles: Complexes, has_cmb: bool, has_isotropic: bool, origin: str
) -> SkyModel:
    """Model that interpolates between maps at several frequencies, or carries a single one with a power law.

    `multipoles` are brightness, shape (map, l, m), K.
    """
    level = multipoles[:, 0, 0].real / np.sqrt(4 * np.pi)
    if np.any(level <= 0):
        raise BadInputError(f"sky {name}", "maps with a positive mean brightness", f"{level.min():g} K")
    relative = multipoles / level[:, None, None]
    weight = np.eye(frequency_mhz.size)
    if frequency_mhz.size == 1:
        level = level[0] * (SINGLE_MAP_NODES_MHZ / frequency_mhz[0]) ** -SYNCHROTRON_INDEX
        frequency_mhz, weight = SINGLE_MAP_NODES_MHZ, np.ones((SINGLE_MAP_NODES_MHZ.size, 1))
        origin = f"{origin}, carried to other frequencies with nu^-{SYNCHROTRON_INDEX}"
    return SkyModel(name, frequency_mhz, level, weight, relative, has_cmb, has_isotropic, origin)


def multipoles_of_maps(maps: Floats, frame: str, place: str) -> Complexes:
    """Multipoles in ICRS of HEALPix maps in ring order, shape (map, pixel) -> (map, l, m)."""
    import healpy as hp

    if not hp.isnpixok(maps.shape[1]):
        raise BadInputError(place, "12 nside^2 pixels", f"{maps.shape[1]}")
    if not np.all(np.isfinite(maps)):
        raise BadInputError(f"{place}, pixel {np.argwhere(~np.isfinite(maps))[0][1]}", "finite brightness", "another")
    lmax = min(LMAX, 3 * hp.npix2nside(maps.shape[1]) - 1)
    dense = np.zeros((maps.shape[0], lmax + 1, lmax + 1), dtype=complex)
    for row, values in enumerate(maps):
        packed = hp.map2alm(values, lmax=lmax, iter=3)
        if frame == "G":
            packed = hp.Rotator(coord=["G", "C"]).rotate_alm(packed)
        # healpy packs by m, then l: the transposed upper triangle.
        dense[row].T[np.triu_indices(lmax + 1)] = packed
    return dense


def _frame_of_pixels(right_ascension: Floats, declination: Floats, pixels: int, place: str) -> str:
    """Whether the pixels are HEALPix in Galactic ("G") or equatorial ("C") coordinates, from where they lie."""
    import healpy as hp

    if right_ascension.shape != (pixels,) or declination.shape != (pixels,) or not hp.isnpixok(pixels):
        raise BadInputError(
            f"{place}: ra, dec", "one direction for each of 12 nside^2 pixels", f"{right_ascension.shape}"
        )
    theta, phi = hp.pix2ang(hp.npix2nside(pixels), np.arange(pixels))
    given = hp.ang2vec(np.pi / 2 - declination, right_ascension)
    for frame in "GC":
        rotator = hp.Rotator(coord=[frame, "C"])
        if np.allclose(hp.ang2vec(*rotator(theta, phi)), given, atol=1e-3):
            return frame
    raise BadInputError(f"{place}: ra, dec", "HEALPix pixels in ring order, Galactic or equatorial", "others")
