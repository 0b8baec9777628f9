"""A sky that is known in every direction, and how bright a sky model is in one."""

from collections.abc import Callable
from dataclasses import dataclass

import healpy as hp
import numpy as np
import pytest

from lbacal_core.sky.model import SkyModel


@dataclass(frozen=True)
class Blob:
    """1000 K, and 5 degrees wide 4000 K more at the Galactic centre."""

    nside: int = 16
    centre_deg: tuple[float, float] = (266.405, -28.936)  # ICRS

    def directions(self, frame: str) -> tuple[np.ndarray, np.ndarray]:
        """ICRS coordinates, in rad, of the pixels of a HEALPix map in the frame G or C."""
        pixels = np.arange(hp.nside2npix(self.nside))
        theta, phi = hp.Rotator(coord=[frame, "C"])(*hp.pix2ang(self.nside, pixels))
        return phi, np.pi / 2 - theta

    def towards(self, ra: np.ndarray, dec: np.ndarray) -> np.ndarray:
        """Brightness temperature, K."""
        cosine = hp.ang2vec(np.pi / 2 - dec, ra) @ hp.ang2vec(*self.centre_deg, lonlat=True)
        return 1000.0 + 4000.0 * np.exp((cosine - 1) / np.radians(10.0) ** 2)

    def as_map(self, frame: str) -> np.ndarray:
        return self.towards(*self.directions(frame))


@pytest.fixture(scope="session")
def blob() -> Blob:
    return Blob()


def _brightness_at(sky: SkyModel, right_ascension_deg: float, declination_deg: float, nu: float = 50.0) -> float:
    values = sky.temperature(np.array([nu]))[0]
    lmax = values.shape[0] - 1
    pixels = hp.alm2map(values.T[np.triu_indices(lmax + 1)], 64, lmax=lmax)
    return float(hp.get_interp_val(pixels, right_ascension_deg, declination_deg, lonlat=True))


@pytest.fixture(scope="session")
def brightness_at() -> Callable[..., float]:
    """What a sky model says of one direction, K."""
    return _brightness_at
