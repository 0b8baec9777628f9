"""Fixed data sets: spectra by the twin, and LST curves from the sky power. No part of discovery makes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.lstcurve.curve import AS_RECORDED, BAND_MHZ, LstCurve, band_weights, measured_curve, read_lst_curve
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.nuisances import NONE, Nuisances
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View
from validation.superterp import power_of, superterp

SIX = (0, 1, 3, 4, 10, 11)
"""Antennas of three cable names, two of each."""
TEN = (0, 1, 2, 6, 7, 8, 9, 12, 3, 4)
"""Eight antennas of one cable name, to be compared with each other, and two of another."""
POINTS, POINT_NOISE_DB = 48, 0.05
"""A simulated LST curve: points a dipole, and their noise."""


@dataclass(frozen=True)
class StationSpectra:
    """The spectra of one year of one or more stations.

    Attributes
    ----------
    seed
        Seed of the campaign's random numbers and of discovery.
    faults
        What is planted.
    events
        Events a year.
    unknown_temperature
        Number, in the order of time, of the event whose temperature is NaN; None where every temperature is known.
    is_own_sky
        Whether the sky power counts as the package's own, so that differences between sky models are profiled out.
    """

    name: str
    seed: int
    faults: tuple[Fault, ...] = ()
    antennas: tuple[int, ...] = SIX
    events: int = 250
    stations: tuple[str, ...] = ("CS002",)
    nuisances: Nuisances = NONE
    unknown_temperature: int | None = None
    is_own_sky: bool = False

    @property
    def instrument(self) -> Instrument:
        """The Superterp with only the antennas used."""
        used = [r for r in superterp().antennas if r.station in self.stations and r.antenna in self.antennas]
        return replace(superterp(), antennas=used)

    def spectra(self) -> Spectra:
        """The same spectra at every call."""
        spectra = simulate_campaign(
            TwinSettings(stations=self.stations, events_per_year=self.events),
            self.instrument,
            power_of(),
            np.random.default_rng([20261121, self.seed]),
            self.faults,
            self.nuisances,
            _view(),
        ).spectra
        if self.unknown_temperature is None:
            return spectra
        instant = np.unique(spectra.time_unix)[self.unknown_temperature]
        temperature = np.where(spectra.time_unix == instant, np.nan, spectra.environment["temperature_c"])
        return replace(spectra, environment={**spectra.environment, "temperature_c": temperature})


@dataclass(frozen=True)
class BandCurve:
    """A band-averaged LST curve.

    Attributes
    ----------
    seed
        Seed of the noise of a simulated curve; None for the measured curve that ships with the package.
    is_exchanged
        Whether X and Y are exchanged.
    late_h
        Hours of LST by which the curve comes late.
    noise_of_sky
        Electronic noise over the mean sky power of the band; in the paper's own simulated curve it is 0.49.
    """

    name: str
    seed: int | None = None
    is_exchanged: bool = False
    late_h: float = 0.0
    is_own_sky: bool = True
    noise_of_sky: float = 0.5

    @property
    def instrument(self) -> Instrument:
        """The Superterp."""
        return superterp()

    def curve(self) -> LstCurve:
        """The same curve at every call."""
        if self.seed is None:
            return read_lst_curve(measured_curve())
        rng = np.random.default_rng([20261121, self.seed])
        weights = band_weights(self.instrument, AS_RECORDED, BAND_MHZ)
        lst_hours = np.arange(POINTS) * 24.0 / POINTS
        variation = {}
        for shown, dipole in zip("XY", "YX" if self.is_exchanged else "XY", strict=True):
            band = power_of().at(dipole, (lst_hours - self.late_h) % 24.0) @ weights
            band = band / band.mean() + self.noise_of_sky
            variation[shown] = 10 * np.log10(band / band[0]) + POINT_NOISE_DB * rng.standard_normal(POINTS)
        return LstCurve(lst_hours, variation, np.full(POINTS, 2 * POINT_NOISE_DB), 24.0 / POINTS, is_centre_stated=True)


DataSet = StationSpectra | BandCurve


@cache
def _view() -> View:
    return View(superterp())
