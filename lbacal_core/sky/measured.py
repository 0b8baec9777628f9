"""The sky `measured`: the default map, carried to the level that the sky has been measured to have."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.sky.model import SkyModel

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
        """Its standard deviation, shape (freq,)."""
        design = np.stack([np.ones_like(frequency_mhz), np.log(frequency_mhz / PIVOT_MHZ)])
        return np.asarray(np.sqrt(np.einsum("if,ij,jf->f", design, self.covariance, design)))

    def as_dict(self) -> dict[str, Any]:
        """The content of its file."""
        covariance = [[round(float(value), 8) for value in row] for row in self.covariance]
        rounded = {name: round(getattr(self, name), 5) for name in ("level", "slope", "scatter")}
        return {"pivot_mhz": PIVOT_MHZ, **rounded, "covariance": covariance}


def read_sky_level() -> SkyLevel:
    """The level that ships with the package, made by validation/scripts/make_sky_anchors.py."""
    content = json.loads((files("lbacal_core") / "data/sky_level.json").read_text())
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
