"""Beam variations: the same antenna turned, tilted, wider or narrower."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from lbacal_core.antenna.model import AntennaModel, Complexes, directional_response
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content


@dataclass(frozen=True)
class VariedAntenna:
    """An antenna model with a changed beam.

    Attributes
    ----------
    azimuth_deg
        The arm is turned by this much, north through east.
    tilt_deg, tilt_towards_deg
        The antenna leans by `tilt_deg` towards an azimuth, counted from the arm; the horizon stays where it is.
    zenith_exponent
        The power pattern is multiplied by cos(zenith)^n: a wrong power of the cosine in the sky integral.
    zenith_gain
        The power pattern at zenith changes by this fraction at fixed total power: it is multiplied by 1 + f h with
        h = (cos(theta) - mean)/(1 - mean), mean the average of cos(theta) over the pattern of each frequency, so
        that h is 1 at zenith and the integral of D h vanishes.
    """

    base: AntennaModel
    azimuth_deg: float = 0.0
    tilt_deg: float = 0.0
    tilt_towards_deg: float = 0.0
    zenith_exponent: float = 0.0
    zenith_gain: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.zenith_gain) <= 0.4:
            raise BadInputError(
                "zenith_gain", "-0.4 to 0.4 (beyond, the pattern turns negative)", f"{self.zenith_gain}"
            )
        if not abs(self.tilt_deg) <= 20.0:
            raise BadInputError("tilt_deg", "-20 to 20", f"{self.tilt_deg}")

    @property
    def name(self) -> str:
        """Name in provenance."""
        changes = {key: value for key, value in self._settings().items() if value}
        return f"{self.base.name}({', '.join(f'{key}={value:g}' for key, value in changes.items())})"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """The base's Jones terms at the turned direction, scaled, shape (freq, ...) each.

        The polarisation basis does not follow a tilt.
        """
        cosine = np.cos(zenith)
        seen_zenith, seen_azimuth = self._direction(np.asarray(zenith, dtype=float), np.asarray(azimuth_from_arm))
        theta, phi = self.base.jones(frequency_mhz, seen_zenith, seen_azimuth)
        visible = cosine > 0
        factor = np.where(visible, cosine, 0.0) ** self.zenith_exponent * visible
        if self.zenith_gain:
            mean = mean_cosine(self.base, frequency_mhz).reshape((-1,) + (1,) * cosine.ndim)
            factor = factor * (1 + self.zenith_gain * (cosine - mean) / (1 - mean))
        return theta * np.sqrt(factor), phi * np.sqrt(factor)

    def tilted(self, tilt_deg: float) -> VariedAntenna:
        """The same with the arm raised: that of the base where it knows how, else the whole pattern turned."""
        raise_base = getattr(self.base, "tilted", None)
        if raise_base is not None:
            return replace(self, base=raise_base(tilt_deg))
        return VariedAntenna(self, tilt_deg=tilt_deg, tilt_towards_deg=180.0)

    def digest(self) -> str:
        """Hash of the base and the changes."""
        return hash_content([self.base.digest(), self._settings()])

    def _settings(self) -> dict[str, float]:
        return {name: value for name, value in vars(self).items() if name != "base"}

    def _direction(self, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Floats, Floats]:
        azimuth = azimuth_from_arm - np.radians(self.azimuth_deg)
        if not self.tilt_deg:
            return zenith, azimuth
        towards, tilt = np.radians(self.tilt_towards_deg), np.radians(self.tilt_deg)
        along = np.sin(zenith) * np.cos(azimuth - towards)
        across = np.sin(zenith) * np.sin(azimuth - towards)
        up = np.cos(zenith)
        along, up = np.cos(tilt) * along - np.sin(tilt) * up, np.sin(tilt) * along + np.cos(tilt) * up
        return np.arccos(np.clip(up, -1.0, 1.0)), np.arctan2(across, along) + towards


def mean_cosine(antenna: AntennaModel, frequency_mhz: Floats) -> Floats:
    """Mean of cos(zenith angle) over the power pattern, shape (freq,)."""
    response, weight, cosine = on_hemisphere(antenna, frequency_mhz)
    return np.asarray((response * weight * cosine).sum(axis=(1, 2)) / (response * weight).sum(axis=(1, 2)))


def on_hemisphere(antenna: AntennaModel, frequency_mhz: Floats) -> tuple[Floats, Floats, Floats]:
    """D on a Gauss-Legendre x uniform grid: response (freq, zenith, azimuth), weights in sr and cos(zenith)."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    cosine, weights = (nodes + 1) / 2, weights / 2
    azimuth = np.arange(16) * np.pi / 8
    response = directional_response(antenna, frequency_mhz, np.arccos(cosine)[:, None], azimuth[None, :])
    return response, weights[:, None] * np.pi / 8, cosine[:, None]


# Arms that do not lie level: an antenna model with its arm raised, on the scale of the level one.

LARGEST_TURN_DEG = 20.0
"""A pattern that was computed above ground is turned as a whole by no more than this."""


@runtime_checkable
class CanTilt(Protocol):
    """An antenna model that knows its own response with the arm raised."""

    def tilted(self, tilt_deg: float) -> AntennaModel:
        """The same antenna with the end of its arm that points to its azimuth raised."""
        ...


def raise_arm(antenna: AntennaModel, tilt_deg: float) -> AntennaModel:
    """The antenna model with its arm raised by a tilt; itself where the arm lies level.

    A model that knows its response at any tilt gives it; the pattern of any other is turned as a whole, away from the
    raised end, ground and all, which holds for small tilts.

    Raises
    ------
    BadInputError
        Where a pattern would have to be turned by more than 20 degrees.
    """
    if tilt_deg == 0.0:
        return antenna
    if isinstance(antenna, CanTilt):
        return antenna.tilted(tilt_deg)
    if abs(tilt_deg) > LARGEST_TURN_DEG:
        raise BadInputError(
            f"antenna {antenna.name}: tilt_deg",
            f"-{LARGEST_TURN_DEG:g} to {LARGEST_TURN_DEG:g} of a pattern that is turned as a whole (short-dipole takes "
            "any tilt; a file of this arm's own Jones terms needs none)",
            f"{tilt_deg:g}",
        )
    return VariedAntenna(antenna, tilt_deg=tilt_deg, tilt_towards_deg=180.0)
