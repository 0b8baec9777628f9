"""Sky models by name or file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.data.tables import SHIPPED, read_content
from lbacal_core.errors import UnknownNameError, UnreadableFileError
from lbacal_core.grids import Floats
from lbacal_core.sky.maps import PYGDSM_NAMES, make_pygdsm_model, read_component_maps
from lbacal_core.sky.model import SkyModel

# The sky `measured`: the default map, carried to the level that the sky has been measured to have.

MEASURED_SKY = "measured"
BASE_SKY = "gsm"
"""The sky whose level is measured; its shape is kept."""
PIVOT_MHZ = 65.0
"""Where level and slope are least correlated, for the anchors that there are."""


@dataclass(frozen=True)
class SkyLevel:
    """Ln of the measured over the modelled brightness, level + slope ln(nu / 65 MHz), in the mean over LST.

    Attributes
    ----------
    covariance
        Shape (2, 2), of (level, slope), scatter between experiments included.
    scatter
        Standard deviation between experiments beyond their stated errors, in ln T.
    """

    level: float
    slope: float
    covariance: Floats
    scatter: float

    def ln_ratio(self, frequency_mhz: Floats) -> Floats:
        """Ln T measured / T modelled, shape (freq,)."""
        return np.asarray(self.level + self.slope * np.log(frequency_mhz / PIVOT_MHZ))

    def sigma(self, frequency_mhz: Floats) -> Floats:
        """Standard deviation of the level, shape (freq,)."""
        design = np.stack([np.ones_like(frequency_mhz), np.log(frequency_mhz / PIVOT_MHZ)])
        return np.asarray(np.sqrt(np.einsum("if,ij,jf->f", design, self.covariance, design)))


def read_sky_level() -> SkyLevel:
    """The level that ships with the package, made by validation/scripts/make_sky_anchors.py."""
    content = read_content("sky_level")
    return SkyLevel(content["level"], content["slope"], np.array(content["covariance"]), content["scatter"])


def tie_to_measurements(sky: SkyModel, level: SkyLevel) -> SkyModel:
    """The sky model with the measured level and slope; its anisotropy relative to its mean stays.

    Levels are rounded to ten digits: the last bits of an exponential differ between machines, digests must not.
    """
    exact = sky.level * np.exp(level.ln_ratio(sky.frequency_mhz))
    return replace(
        sky,
        name=MEASURED_SKY,
        level=np.array([float(f"{value:.10g}") for value in exact]),
        origin=f"{sky.origin}; level and slope as measured (docs/explanation/measured-sky.md)",
    )


DEFAULT_SKY = "gsm"
DEFAULT_TO_MHZ = 120.0
"""End of the default sky."""
WIDE_SKY = "gsm-wide"
WIDE_SKIES = ("gsm-wide", "haslam-wide", "lfsm-wide")
"""Skies from 10 to 408 MHz (validation/scripts/make_skies.py)."""


def default_sky(frequency_mhz: Floats) -> str:
    """The sky model for channels where nobody names one: the default, and beyond its end the wide one."""
    return DEFAULT_SKY if np.max(frequency_mhz) <= DEFAULT_TO_MHZ else WIDE_SKY


def list_skies() -> list[str]:
    """Names of the sky models that ship with the package."""
    names = (path.name for path in (SHIPPED / "skies").iterdir())
    return sorted(name.removesuffix(".json") for name in names if name.endswith(".json"))


def load_sky(name_or_file: str) -> SkyModel:
    """The sky model of a name, of a file of component maps (.npz), or of FITS maps (a file or a folder)."""
    if name_or_file == MEASURED_SKY:
        return tie_to_measurements(load_sky(BASE_SKY), read_sky_level())
    shipped = list_skies()
    for names, folder in ((shipped, "skies"), (WIDE_SKIES, "skies/wide")):
        if name_or_file in names:
            return _parse_sky(read_content(f"{folder}/{name_or_file}"))
    if name_or_file in PYGDSM_NAMES:
        return make_pygdsm_model(name_or_file)
    path = Path(name_or_file)
    if path.suffix == ".npz" and path.is_file():
        return read_component_maps(path)
    if path.is_dir() or (path.suffix == ".fits" and path.is_file()):
        from lbacal_core.sky.fits_maps import read_fits_maps  # astropy.io.fits takes time to load

        return read_fits_maps(path)
    if path.is_file():
        raise UnreadableFileError(f"{path}: expected a sky model, a file that ends in .npz or .fits")
    raise UnknownNameError("sky model", name_or_file, sorted([*shipped, *WIDE_SKIES, MEASURED_SKY, *PYGDSM_NAMES]))


def _parse_sky(content: dict[str, Any]) -> SkyModel:
    rows = np.array(content["multipoles"]["rows"], dtype=float)
    order, m = rows[:, 0].astype(int), rows[:, 1].astype(int)
    components = (rows.shape[1] - 2) // 2
    multipoles = np.zeros((components, order.max() + 1, order.max() + 1), dtype=complex)
    multipoles[:, order, m] = (rows[:, 2::2] + 1j * rows[:, 3::2]).T
    return SkyModel(
        name=content["name"],
        frequency_mhz=np.array(content["frequency_mhz"]),
        level=np.array(content["level_k"]),
        weight=np.array(content["weight"]),
        multipoles=multipoles,
        has_cmb=content["has_cmb"],
        has_isotropic=content["has_isotropic"],
        origin=content["origin"],
    )
