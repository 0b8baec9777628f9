"""The sky through an antenna against its model, where the laboratory knows the receiver: data calibrated in kelvin.

The recorded power is then the temperature behind the antenna, k_B T = P_sky G_ant + noise: C is known, C^2 = k_B per
MHz, within the error of the laboratory, and the slope tests the product of sky model and G_ant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lbacal_core.grids import Floats

WATT_PER_MHZ = 1.380649e-17
"""Noise power of 1 K, W/MHz: k_B, which the SI fixes."""


@dataclass(frozen=True)
class SkyOverModel:
    """How bright the sky is that a path records, over the model's.

    Attributes
    ----------
    ratio
        Measured over modelled P_sky G_ant, shape (freq,); NaN where C is not determined.
    sigma_stat
        Standard deviation by the noise of the data, shape (freq,).
    sigma_laboratory
        That by the receiver's calibration, which moves all channels together.
    mean, mean_sigma_stat
        Mean over the channels and its error by the noise.
    c, c_sigma
        C by the laboratory, V per root kelvin, and its error.
    """

    ratio: Floats
    sigma_stat: Floats
    sigma_laboratory: float
    mean: float
    mean_sigma_stat: float
    c: float
    c_sigma: float

    @classmethod
    def of(cls, c: Floats, covariance: Floats, error: float) -> SkyOverModel:
        """The level from a C that was fitted with the model's sky.

        Parameters
        ----------
        c
            Fitted, shape (freq,), NaN where not determined.
        covariance
            Statistical covariance of ln C, shape (freq, freq).
        error
            Error of the receiver's calibration, a fraction of the power.
        """
        known = WATT_PER_MHZ**0.5
        ratio, at = known**2 / c**2, np.isfinite(c)
        # ln s = -2 ln C + const
        of_ratio = 4.0 * covariance * np.outer(ratio, ratio)
        sigma = np.sqrt(np.diag(of_ratio))
        weight = np.where(at, np.where(at, sigma, 1.0) ** -2.0, 0.0)
        weight /= weight.sum()
        some = np.ix_(at, at)
        return cls(
            ratio=ratio,
            sigma_stat=np.where(at, sigma, np.nan),
            sigma_laboratory=error,
            mean=float(weight[at] @ ratio[at]),
            mean_sigma_stat=float(np.sqrt(weight[at] @ of_ratio[some] @ weight[at])),
            c=known,
            c_sigma=known * error / 2.0,
        )

    def as_dict(self) -> dict[str, Any]:
        """The content as JSON values; null where C is not determined."""
        return {
            "ratio": [value if np.isfinite(value) else None for value in self.ratio.tolist()],
            "sigma_stat": [value if np.isfinite(value) else None for value in self.sigma_stat.tolist()],
            "sigma_laboratory": self.sigma_laboratory,
            "mean": self.mean,
            "mean_sigma_stat": self.mean_sigma_stat,
            "c": self.c,
            "c_sigma": self.c_sigma,
        }

    def __str__(self) -> str:
        """What a user is told."""
        return (
            f"the sky through this antenna is {self.mean:.3f} +- {self.mean_sigma_stat:.3f} (noise) +- "
            f"{self.sigma_laboratory * self.mean:.3f} (laboratory) of the model"
        )


def parse_sky_over_model(content: Mapping[str, Any] | None) -> SkyOverModel | None:
    """Make the level from its JSON values."""
    if content is None:
        return None
    ratio, sigma = (np.array(content[name], dtype=float) for name in ("ratio", "sigma_stat"))
    return SkyOverModel(ratio, sigma, *(content[name] for name in (
        "sigma_laboratory", "mean", "mean_sigma_stat", "c", "c_sigma",
    )))  # fmt: skip
