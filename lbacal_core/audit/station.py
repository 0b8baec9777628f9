"""The spectra of one station as the audit compares them: antennas beside each other, each through its own cable."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.paths import radiometer_limit
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S, local_sidereal_time
from lbacal_core.linear import find_whitener, invert_symmetric, solve_symmetric
from lbacal_core.spectra.spectra import Spectra

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
        """Sidereal time that is covered, hours: days on end at one sidereal time show no more than one of them."""
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

    def at(self, instants: NDArray[np.bool_]) -> AuditedStation:
        """The station at some of its instants."""
        times, hours = self.time_unix[instants], self.lst_hours[instants]
        return replace(self, power=self.power[:, :, instants], time_unix=times, lst_hours=hours)

    def with_cables(self, cables: Mapping[int, str], instrument: Instrument) -> AuditedStation:
        """The station with other cables of the instrument, by the row of an antenna, which is not its number."""
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
    instrument.require_dipoles(spectra.dipole, spectra.origin, spectra.arms_deg)
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
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN", RuntimeWarning)  # a path without spectra
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
    """Robust standard deviation along an axis, which the shape loses; NaN left out."""
    centre = np.nanmedian(values, axis=axis, keepdims=True)
    return np.asarray(ROBUST * np.nanmedian(np.abs(values - centre), axis=axis))


# What a station saw of the sky with time: the power of its polarisations in a few bands, and the noise of that.
#
# The power of a band, over its mean, is 1 + k (P_sky / mean P_sky - 1): the share k of the sky in the power dilutes how
# it changes. Each band of each polarisation has a level and a share of its own. The covariance holds the scatter of the
# antennas, the gain of each instant (common to everything), what the exchange of a sky or antenna model for another
# changes, and departures of the sky from all models that last for hours.

BANDS = 4
LONGEST = 96
"""Instants; more are averaged: a quarter of an hour of a day."""
SHARE, SHARE_SPREAD, BAND_SPREAD = 0.7, read_prior()["electronics_share"].size, 0.15
"""Share of the sky in the recorded power, how well it is known, and its spread from band to band: electronic noise is
15-50 % of the power in the published noise terms."""
GAIN = read_prior()["event_gain"].size
"""Gain of an instant, common to all antennas and channels."""
SKY_COMMON, SKY_POLARISATION, SKY_BAND = read_prior()["sky_for_hours"].sizes
SKY_HOURS = 3.0
"""How long departures of the LST shape from all models last."""
UNUSUAL = {1.0: 0.0, 3.0: 1.5, 8.0: 3.0, 20.0: 4.5}
"""Departures of polarisations and bands over those of the sky, and ln of the odds against them before the data are
asked: gains of receivers change their colour with the hour, by a per cent or a few."""
ALONE = 3.0
"""The least of them where there are too few antennas for a median: the colour is that of one receiver."""
MISFIT = 5.0
"""Standard deviations of chi^2 by which what fits does not exceed its expectation."""
FREE = 1.0
MEDIAN = np.pi / 2
"""Variance of a median of n values times n."""
SMALLEST_NOISE = 1e-3


@dataclass(frozen=True)
class Seen:
    """Power of the sky that a station should record.

    Attributes
    ----------
    change
        P_sky over its mean in time, less 1, shape (dipole, band, time).
    differences
        What other models differ by in this, one standard deviation each, shape (exchange, dipole, band, time).
    """

    change: Floats
    differences: Floats


@dataclass(frozen=True)
class Series:
    """Power against time, over its mean, of a station.

    Attributes
    ----------
    lst_hours
        Shape (time,), by the clock and place on record.
    power
        Shape (dipole, band, time), mean 1 over time.
    noise
        Standard deviation by the scatter of the antennas, same shape.
    """

    lst_hours: Floats
    power: Floats
    noise: Floats


def mean_frequencies(frequency_mhz: Floats) -> Floats:
    """Mean frequency of each of `BANDS` bands of as many channels, shape (band,), MHz."""
    return np.array([band.mean() for band in np.array_split(frequency_mhz, BANDS)])


def make_series(station: AuditedStation, rows: NDArray[np.int64]) -> Series:
    """Average the usable antennas and the channels of each band.

    Parameters
    ----------
    rows
        Rows of the antennas in the station, not their numbers.
    """
    power = station.power[rows] / station.loss[rows][:, None, None, :]
    bands = np.array_split(np.arange(station.frequency_mhz.size), BANDS)
    level = np.nanmedian(power, axis=2, keepdims=True)
    of_band = np.stack([np.nanmedian(power[..., band] / level[..., band], axis=-1) for band in bands], axis=2)
    bins = _bin_times(station.time_unix, station.lst_hours)
    binned = np.stack([np.nanmean(of_band[..., bins == k], axis=-1) for k in range(bins.max() + 1)], axis=-1)
    lst = np.array([_mean_hour(station.lst_hours[bins == k]) for k in range(bins.max() + 1)])
    seen = np.nanmedian(binned, axis=0)
    count = np.maximum(np.sum(np.isfinite(binned), axis=0), 1)
    scatter = spread(binned - np.nanmedian(binned, axis=-1, keepdims=True))
    noise = np.maximum(MEDIAN**0.5 * scatter / count**0.5, SMALLEST_NOISE)
    noise = np.maximum(noise, _scatter_of_instants(seen)[..., None])
    mean = np.nanmean(seen, axis=-1, keepdims=True)
    is_whole = np.all(np.isfinite(seen), axis=(0, 1))
    seen, noise = (seen / mean)[..., is_whole], (noise / mean)[..., is_whole]
    return Series(lst[is_whole], seen, noise)


def _scatter_of_instants(seen: Floats) -> Floats:
    """How much an instant departs from its neighbours in a band more than in all of them, shape (dipole, band)."""
    if seen.shape[-1] < FEWEST_INSTANTS:
        return np.zeros(seen.shape[:2])
    own = np.log(seen) - np.nanmean(np.log(seen), axis=(0, 1))
    bend = own[..., 1:-1] - (own[..., :-2] + own[..., 2:]) / 2
    return np.asarray(np.nan_to_num(spread(bend, axis=-1)) / BEND * np.nanmedian(seen, axis=-1))


FEWEST_INSTANTS = 8
CLEAR, FOLLOWS = 3.0, (0.3, 2.0)
"""What stands this far above the noise is a change; and the range in which a band can follow it."""


def as_power(recorded: Floats, unit: str) -> Floats:
    """Power, same shape, if the recorded values are in a unit: `power`, `dB` or `volt`."""
    if unit == "dB":
        return np.asarray(10 ** (recorded / 10))
    return recorded**2 if unit == "volt" else recorded


def _bin_times(time_unix: Floats, lst_hours: Floats) -> NDArray[np.int64]:
    """Instants that are averaged: neighbours in time, or in sidereal time where the data are of more than a day."""
    if time_unix.size <= LONGEST:
        return np.arange(time_unix.size)
    span = time_unix[-1] - time_unix[0]
    phase = (time_unix - time_unix[0]) / span if span < SIDEREAL_DAY_S * (1 + 1 / LONGEST) else lst_hours / 24.0
    raw = np.minimum(phase * LONGEST // 1, LONGEST - 1)
    return np.asarray(np.unique(raw, return_inverse=True)[1])


def _mean_hour(hours: Floats) -> float:
    return float(np.angle(np.mean(np.exp(2j * np.pi / 24 * hours))) * 12 / np.pi % 24)


def _follow(series: Series) -> Floats:
    """How much of the change of all bands each band follows, shape (dipole x band,): as its share of the sky does."""
    change = series.power.reshape(-1, series.power.shape[-1]) - 1.0
    common = change.mean(axis=0)
    if change.shape[1] < FEWEST_INSTANTS or common.std() < CLEAR * series.noise.mean():
        return np.ones(len(change))
    return np.asarray(np.clip(change @ common / (common @ common), *FOLLOWS))


class SeriesLikelihood:
    """ln L of a series for any shape that the sky may have had, with departures of some size from all models."""

    def __init__(self, series: Series, unusual: float = 1.0) -> None:
        self.series = series
        self.follows = _follow(series)
        dipoles, bands, times = series.power.shape
        hours = series.lst_hours[:, None] - series.lst_hours
        lasting = np.exp((np.cos(2 * np.pi / 24 * hours) - 1) * (24 / (2 * np.pi * SKY_HOURS)) ** 2)
        same = np.eye(dipoles * bands)
        dipole = np.kron(np.eye(dipoles), np.ones((bands, bands)))
        everything = np.ones_like(same)
        together = np.outer(self.follows, self.follows)
        departures = SKY_COMMON**2 * together + unusual**2 * (SKY_POLARISATION**2 * dipole + SKY_BAND**2 * same)
        covariance = np.kron(departures, lasting)
        covariance += np.kron(GAIN**2 * everything, np.eye(times))
        covariance += np.kron(FREE**2 * same, np.ones((times, times)))
        covariance[np.diag_indices_from(covariance)] += series.noise.ravel() ** 2
        self.covariance: Floats = np.asarray(covariance)
        self.whiten = find_whitener(self.covariance)
        self.log_determinant = float(np.linalg.slogdet(covariance)[1])
        self.rest = self.whiten @ (series.power.ravel() - 1.0)

    def log_likelihood(self, seen: Seen) -> float:
        """Log likelihood, up to a constant that no departures change."""
        chi2, volume = self.compare(seen)
        return -chi2 / 2 - volume

    def compare(self, seen: Seen) -> tuple[float, float]:
        """Chi^2, and ln of the volume of what the data may be."""
        shares, differences = self._whiten_changes(seen)
        count = shares.shape[1]
        prior = np.eye(count + differences.shape[1])
        prior[:count, :count] = BAND_SPREAD**2 * np.eye(count) + SHARE_SPREAD**2
        columns = np.hstack([shares, differences])
        rest = self.rest - SHARE * shares.sum(axis=1)
        inner = invert_symmetric(prior) + columns.T @ columns
        along = (columns.T @ rest)[:, None]
        chi2 = rest @ rest - float(np.sum(along * solve_symmetric(inner, along)))
        determinants = [np.linalg.slogdet(one)[1] for one in (inner, prior)]
        return float(chi2), float(sum(determinants) + self.log_determinant) / 2

    def share(self, seen: Seen) -> tuple[float, float]:
        """The share of the sky in the power that the data show, in the mean of the bands, and its error."""
        shares, differences = self._whiten_changes(seen)
        count = shares.shape[1]
        columns = np.hstack([shares, differences])
        information = columns.T @ columns + np.diag([1e-6] * count + [1.0] * differences.shape[1])
        covariance = invert_symmetric(information)
        of_bands = covariance @ (columns.T @ self.rest)
        weights = invert_symmetric(covariance[:count, :count] + BAND_SPREAD**2 * np.eye(count)).sum(axis=1)
        return float(weights @ of_bands[:count] / weights.sum()), float(weights.sum() ** -0.5)

    def _whiten_changes(self, seen: Seen) -> tuple[Floats, Floats]:
        """The change of the sky in each band and polarisation, and model differences; shape (value, column) each."""
        dipoles, bands, times = seen.change.shape
        columns = np.zeros((dipoles * bands, times, dipoles * bands))
        each = np.arange(dipoles * bands)
        columns[each, :, each] = seen.change.reshape(-1, times)
        shown = SHARE * self.follows.reshape(dipoles, bands, 1) * seen.differences
        differences = shown.reshape(len(shown), dipoles * bands * times).T
        whitened = self.whiten @ np.hstack([columns.reshape(-1, each.size), differences])
        return whitened[:, : each.size], whitened[:, each.size :]


class AnyReceiver:
    """ln L of a series of so many antennas, whether their receivers keep their colour along the hours or not."""

    def __init__(self, series: Series, antennas: int) -> None:
        self.series = series
        known = 0.0 if antennas >= FEWEST else ALONE
        self._sizes = {size: SeriesLikelihood(series, size) for size in UNUSUAL if size >= known}

    def _weigh(self, seen: Seen) -> dict[float, float]:
        return {size: one.log_likelihood(seen) - UNUSUAL[size] for size, one in self._sizes.items()}

    def log_likelihood(self, seen: Seen) -> float:
        """Log likelihood, up to a constant."""
        return float(np.logaddexp.reduce(list(self._weigh(seen).values())))

    def share(self, seen: Seen) -> tuple[float, float]:
        """The share of the sky in the power, and its error, with receivers that keep their colour."""
        return self._sizes[min(self._sizes)].share(seen)

    def fits(self, seen: Seen) -> bool:
        """Whether the data are what may be seen of this sky, with the likeliest departures."""
        each, values = self._weigh(seen), self.series.power.size
        chi2, _ = self._sizes[max(each, key=lambda size: each[size])].compare(seen)
        return bool(chi2 < values + MISFIT * (2.0 * values) ** 0.5)
