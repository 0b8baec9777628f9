"""Sky models from FITS maps, such as LFmap's: a file of its own, because astropy takes half a second to load."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import healpy as hp
import numpy as np
from astropy.io import fits
from astropy.io.fits.verify import VerifyError, VerifyWarning
from astropy.utils.exceptions import AstropyUserWarning
from astropy.wcs import WCS
from scipy.ndimage import map_coordinates

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import Floats
from lbacal_core.sky.maps import model_of_maps, multipoles_of_maps
from lbacal_core.sky.model import SkyModel

_FAILURES = (OSError, TypeError, ValueError, KeyError, IndexError, AttributeError, VerifyError, AstropyUserWarning)
"""What astropy raises on broken files."""


def read_fits_maps(path: Path) -> SkyModel:
    """Read one FITS map, or a folder of them at several frequencies, as total brightness temperature in K.

    Each file is a HEALPix table or a plate-carree image (CTYPE1 RA---CAR or GLON-CAR, as LFmap makes after
    conversion), with its frequency in the header: FREQ, in Hz or, below 10^5, in MHz. HASCMB and HASISO (T or F;
    default T) state what the map contains. A single map is carried to other frequencies with nu^-2.55.
    """
    files = sorted(path.glob("*.fits")) if path.is_dir() else [path]
    if not files:
        raise UnreadableFileError(f"{path}: expected FITS maps in the folder, found none")
    read = sorted((_read_fits(file) for file in files), key=lambda one: one[0])
    frequency_mhz = np.array([one[0] for one in read])
    if np.any(np.diff(frequency_mhz) <= 0):
        raise BadInputError(str(path), "one map at each frequency", "two maps at the same")
    if len({one[2:] for one in read}) != 1:
        raise BadInputError(str(path), "maps that agree in COORDSYS, HASCMB and HASISO", "maps that differ")
    frame, has_cmb, has_isotropic = read[0][2:]
    multipoles = np.concatenate([multipoles_of_maps(one[1][None], frame, str(path)) for one in read])
    return model_of_maps(path.stem, frequency_mhz, multipoles, has_cmb, has_isotropic, path.name)


def _read_fits(path: Path) -> tuple[float, Floats, str, bool, bool]:
    try:
        with warnings.catch_warnings():
            # A truncated file is one to refuse; headers that are only irregular are not.
            warnings.simplefilter("error", AstropyUserWarning)
            warnings.simplefilter("ignore", VerifyWarning)
            with path.open("rb") as stream, fits.open(stream, memmap=False) as file:
                unit = next((one for one in file if one.header.get("NAXIS", 0) and one.data is not None), None)
                if unit is None:
                    raise UnreadableFileError(f"{path}: expected a map, found no data")
                header, data = unit.header, unit.data
                if header.get("PIXTYPE") == "HEALPIX":
                    values = np.concatenate([np.ravel(row) for row in data.field(0)]).astype(float)
                else:
                    values = np.asarray(data, dtype=float)
    except _FAILURES as error:
        raise UnreadableFileError(f"{path}: expected a FITS map, found a broken one ({error})") from error
    frequency = header.get("FREQ")
    if not isinstance(frequency, int | float) or not frequency > 0:
        raise BadInputError(f"{path}: FREQ", "the frequency in Hz or MHz in the header", repr(frequency))
    frequency_mhz = frequency / 1e6 if frequency > 1e5 else float(frequency)
    if header.get("PIXTYPE") == "HEALPIX":
        frame = str(header.get("COORDSYS", "")).strip()[:1]
        if frame not in ("G", "C"):
            raise BadInputError(f"{path}: COORDSYS", "G or C", repr(header.get("COORDSYS")))
        if str(header.get("ORDERING", "RING")).strip() == "NESTED":
            values = hp.reorder(values, n2r=True)
    else:
        values, frame = _sample_image(values, header, path)
    return frequency_mhz, values, frame, bool(header.get("HASCMB", True)), bool(header.get("HASISO", True))


def _sample_image(image: Floats, header: Any, path: Path) -> tuple[Floats, str]:
    """A plate-carree image on the pixels of nside 64, by bilinear interpolation, periodic in longitude."""
    kind = str(header.get("CTYPE1", ""))
    frames = {"RA---CAR": "C", "GLON-CAR": "G"}
    if image.ndim != 2 or kind not in frames:
        raise BadInputError(f"{path}: CTYPE1", "RA---CAR or GLON-CAR of a 2-D image, or a HEALPix table", repr(kind))
    longitude, latitude = hp.pix2ang(64, np.arange(hp.nside2npix(64)), lonlat=True)
    step = header.get("CDELT1")
    if not isinstance(step, int | float) or not 0 < abs(step) <= 10:
        raise BadInputError(f"{path}: CDELT1", "degrees a pixel, at most 10", repr(step))
    x, y = WCS(header, naxis=2).all_world2pix(longitude, latitude, 0)
    around = 360.0 / abs(step)
    wrapped = np.concatenate([image, image[:, :1]], axis=1)
    return map_coordinates(wrapped, [np.clip(y, 0, image.shape[0] - 1), x % around], order=1, mode="nearest"), frames[
        kind
    ]
