"""The sky by direction, as the twin sees it: a plain sum over pixels, sharing no code with the sky power it is given.

It only ever answers with a ratio (the sky with an effect over the sky without), because the sky power of a campaign may
come from a file that knows no directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.antenna.model import AntennaModel, Complexes
from lbacal_core.antenna.names import DEFAULT_ANTENNA, load_antenna
from lbacal_core.antenna.varied import raise_arm
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import DEFAULT_SKY, default_sky, load_sky
from lbacal_twin.bodies import horizontal, on_the_equator_of

EPOCH = 2015.0
SIDE = 16
"""HEALPix side: pixels of 3.7 degrees under a beam of 100 degrees."""
LST_GRID = np.arange(24.0)
NODES = 11
"""Frequencies of the sum; ratios are smooth between them."""

Weighting = Callable[[Floats, Floats], Floats]
"""Changes D: from the zenith angle (lst, pixel) and D (lst, dipole, node, pixel) to D with the effect."""


@dataclass(frozen=True)
class View:
    """Sky and antenna by which an instrument's P_sky is computed; the default ones unless others are given.

    Attributes
    ----------
    sky, antenna
        Names or files of models, or models.
    """

    instrument: Instrument
    sky: str | SkyModel = DEFAULT_SKY
    antenna: str | AntennaModel = DEFAULT_ANTENNA

    @classmethod
    def of(cls, instrument: Instrument) -> View:
        """The view of an instrument with the default sky of its channels and its own antenna."""
        return cls(instrument, default_sky(instrument.frequency_mhz), instrument.antenna or DEFAULT_ANTENNA)

    def response(self, zenith: Floats, azimuth: Floats, frequency_mhz: Floats, turned_deg: float = 0.0) -> Floats:
        """D of each dipole towards directions of shape (...), 1 at zenith; shape (dipole, ..., freq)."""
        antenna = load_antenna(self.antenna) if isinstance(self.antenna, str) else self.antenna
        around = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        at_zenith = _power(antenna.jones(frequency_mhz, np.zeros(8), around)).mean(axis=-1)
        patterns = []
        for dipole in self.instrument.dipoles:
            arm = np.radians(self.instrument.dipole_azimuth_deg[dipole] + turned_deg)
            raised = raise_arm(antenna, self.instrument.tilt_deg(dipole))
            pattern = _power(raised.jones(frequency_mhz, zenith, azimuth - arm))
            patterns.append(np.moveaxis(pattern / np.reshape(at_zenith, (-1,) + (1,) * zenith.ndim), 0, -1))
        return np.stack(patterns)

    @cached_property
    def nodes_mhz(self) -> Floats:
        """Frequencies of the sum over pixels, shape (node,)."""
        return np.linspace(self.instrument.frequency_mhz[0], self.instrument.frequency_mhz[-1], NODES)

    @cached_property
    def _temperature(self) -> tuple[Floats, Floats, Floats]:
        """Right ascension and declination of date, shape (pixel,), and temperature, shape (node, pixel)."""
        import healpy

        sky = (load_sky(self.sky) if isinstance(self.sky, str) else self.sky).temperature(self.nodes_mhz)
        lmax = sky.shape[1] - 1
        order = healpy.Alm.getlm(lmax)
        maps = [healpy.alm2map(multipoles[order], SIDE, lmax=lmax) for multipoles in sky]
        colatitude, longitude = healpy.pix2ang(SIDE, np.arange(healpy.nside2npix(SIDE)))
        right_ascension, declination = on_the_equator_of(EPOCH, longitude, np.pi / 2 - colatitude)
        return right_ascension, declination, np.array(maps)

    @cached_property
    def _grid(self) -> tuple[Floats, Floats, Floats]:
        """Zenith angle and azimuth, shape (lst, pixel), and D, shape (dipole, lst, pixel, node)."""
        right_ascension, declination, _ = self._temperature
        latitude = self.instrument.latitude_deg
        zenith, azimuth = horizontal(right_ascension, declination, LST_GRID[:, None], latitude)
        return zenith, azimuth, self.response(zenith, azimuth, self.nodes_mhz)

    def sum(self, pattern: Floats) -> Floats:
        """Sum of the sky under a pattern of shape (dipole, lst, pixel, node); shape (dipole, lst, node), K."""
        return np.asarray(np.einsum("dlpn,np->dln", pattern, self._temperature[2], optimize=True))

    def ratio(self, weighting: Weighting, lst_hours: Floats, turned_deg: float = 0.0) -> Floats:
        """Sky power with an effect over that without, at one LST an event; shape (1, dipole, event, freq).

        Parameters
        ----------
        weighting
            From zenith angle, shape (lst, pixel, 1), and D to D with the effect.
        turned_deg
            How far both arms are turned from their record.
        """
        zenith, azimuth, pattern = self._grid
        changed = self.response(zenith, azimuth, self.nodes_mhz, turned_deg) if turned_deg else pattern
        ratio = self.sum(weighting(zenith[..., None], changed)) / self.sum(pattern)
        return self._between(ratio, lst_hours)

    def _between(self, values: Floats, lst_hours: Floats) -> Floats:
        """Fourier series in LST and spline in frequency of values of shape (dipole, lst, node)."""
        size = LST_GRID.size
        terms = np.fft.rfft(values, axis=1) / size
        order = np.arange(terms.shape[1])
        phase = np.exp(2j * np.pi / 24.0 * np.outer(lst_hours, order)) * np.where(
            (order == 0) | (order == size / 2), 1, 2
        )
        at_events = np.real(np.einsum("em,dmn->den", phase, terms))
        return np.asarray(CubicSpline(self.nodes_mhz, at_events, axis=-1)(self.instrument.frequency_mhz))[None]

    @cached_property
    def mean_kelvin_sr(self) -> Floats:
        """Mean over LST and dipoles of the sum of T D over the sky, shape (freq,), K sr."""
        pixel_sr = 4 * np.pi / (12 * SIDE**2)
        mean = self.sum(self._grid[2]).mean(axis=(0, 1)) * pixel_sr
        return np.asarray(np.exp(CubicSpline(self.nodes_mhz, np.log(mean))(self.instrument.frequency_mhz)))


def _power(jones: tuple[Complexes, Complexes]) -> Floats:
    theta, phi = jones
    return np.asarray(np.abs(theta) ** 2 + np.abs(phi) ** 2)
