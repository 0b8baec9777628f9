"""The spectra of one station as the audit compares them: antennas beside each other, each through its own cable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.paths import radiometer_limit
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument import Instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.spectra import Spectra

ROBUST = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class AuditedStation:
    """The spectra of one station.

    Attributes
    ----------
    dipoles
        Letters of the dipoles.
    power
        Shape (antenna, dipole, time, freq), as recorded; NaN where there is no spectrum.
    antennas, cables
        Number and cable on record of each antenna, shape (antenna,).
    loss
        L_coax of each antenna's cable, shape (antenna, freq).
    time_unix, lst_hours
        Shape (time,).
    scatter
        Scatter of the channels of a spectrum about their neighbours, from one to the next, over the least that power
        can have by its blocks or duration; NaN for fewer than three channels or instants.
    """

    name: str
    dipoles: tuple[str, ...]
    frequency_mhz: Floats
    power: Floats
    antennas: NDArray[np.int64]
    cables: NDArray[np.str_]
    loss: Floats
    time_unix: Floats
    lst_hours: Floats
    scatter: float

    @property
    def hours(self) -> float:
        """Sidereal time that is covered: days on end at one sidereal time show no more of the sky than one of them."""
        sky = np.sort(self.lst_hours)
        gaps = np.diff(sky, append=sky[0] + 24.0)
        return float(gaps[gaps < LARGEST_GAP_H].sum())

    @property
    def length(self) -> str:
        """How long the data are, in words."""
        if self.time_unix.size == 1:
            return "one spectrum a path does"
        covered = f"{60 * self.hours:.0f} min" if self.hours < LONG_HOURS else f"{self.hours:.1f} h"
        return f"{covered} of sidereal time do"

    def with_cables(self, cables: Mapping[int, str], instrument: Instrument) -> AuditedStation:
        """The station with other cables at some rows."""
        names, loss = self.cables.astype(object), self.loss.copy()
        for row, name in cables.items():
            names[row], loss[row] = name, instrument.cables[name]
        return replace(self, cables=names.astype(str), loss=loss)

    def before_cable(self) -> Floats:
        """ln(P / L_coax), shape (antenna, dipole, time, freq)."""
        return np.asarray(np.log(self.power) - np.log(self.loss)[:, None, None, :])


def split_stations(spectra: Spectra, instrument: Instrument) -> Iterator[AuditedStation]:
    """The stations of some spectra, by name."""
    require_same_grid(spectra.origin, spectra.frequency_mhz, instrument.frequency_mhz, instrument.name)
    instrument.require_dipoles(spectra.dipole, spectra.origin)
    least = radiometer_limit(spectra)
    for station in np.unique(spectra.station):
        rows = np.flatnonzero(spectra.station == station)
        antennas, at = np.unique(spectra.antenna[rows], return_inverse=True)
        times, when = _find_instants(spectra, rows)
        dipole = np.searchsorted(instrument.dipoles, spectra.dipole[rows])
        power = np.full((antennas.size, len(instrument.dipoles), times.size, spectra.frequency_mhz.size), np.nan)
        power[at, dipole, when] = spectra.power[rows]
        first = np.full(antennas.size, np.inf)
        np.minimum.at(first, at, spectra.time_unix[rows])
        cables = np.array(
            [instrument.cable_of(str(station), int(a), float(t)) for a, t in zip(antennas, first, strict=True)]
        )
        yield AuditedStation(
            str(station),
            instrument.dipoles,
            spectra.frequency_mhz,
            power,
            antennas,
            cables,
            np.array([instrument.cables[cable] for cable in cables]),
            times,
            local_sidereal_time(times, instrument.at_station(str(station)).longitude_deg),
            _scatter(power) / least,
        )


def _scatter(power: Floats) -> float:
    """Robust relative scatter of a channel beside its neighbours, of power of shape (antenna, dipole, time, freq)."""
    if min(power.shape[2:]) < FEWEST_TO_SCATTER:
        return float("nan")
    own = np.log(power)
    bend = own[..., 1:-1] - (own[..., :-2] + own[..., 2:]) / 2
    bend = bend - np.nanmedian(bend, axis=2, keepdims=True)
    return float(ROBUST * np.nanmedian(np.abs(bend)) / BEND)


def _find_instants(spectra: Spectra, rows: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """Mean time of each event, rising, and which of them each row is: clocks of antennas may differ within an event."""
    events, at = np.unique(spectra.event_id[rows], return_inverse=True)
    times = np.bincount(at, spectra.time_unix[rows]) / np.bincount(at)
    order = np.argsort(times, kind="stable")
    rank = np.empty(events.size, dtype=np.int64)
    rank[order] = np.arange(events.size)
    return times[order], rank[at]


FEWEST_TO_SCATTER = 3
BEND = 1.5**0.5
"""Scatter of a channel less the mean of its two neighbours over that of a channel."""
LONG_HOURS = 2.0
LARGEST_GAP_H = 2.0
"""The sky between two spectra that are farther apart is not seen."""
FEWEST = 4
"""Antennas below which a median says nothing about the others."""


def spread(values: Floats, axis: int = 0) -> Floats:
    """Robust standard deviation along an axis, NaN left out."""
    centre = np.nanmedian(values, axis=axis, keepdims=True)
    return np.asarray(ROBUST * np.nanmedian(np.abs(values - centre), axis=axis))
