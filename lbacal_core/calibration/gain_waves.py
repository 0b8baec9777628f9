"""Gains of events that follow sidereal time: no sky makes them, and no cause of the catalogue.

A gain that follows LST multiplies all that is recorded; a sky that does shows with its share of the power, which has
the form of the resonance along frequency. The lines of a path absorb most of either, and what is left beside them on a
few smooth functions of frequency (`chain_test`) is what a free sky may leave. Here all channels and events tell the two
apart: the recorded power times 1 + sum_k g_k w_k(LST), with harmonics w_k of the sidereal day, beside lines that are
free in every channel and a sky that is free within what a search for causes leaves it.

With the score t of g, the sky and the lines profiled out, and its information I, the data are

    ln odds = t^T (I + 1/q^2)^-1 t / 2 - ln|1 + q^2 I| / 2

times as likely with gains g ~ N(0, q^2) as without. Fit and investigation put this question to the same means of a
station's paths, and hold the answer against the same limit.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from lbacal_core.calibration.chain_test import LARGEST_GAIN, FittedPaths
from lbacal_core.calibration.lines import ROUNDING, ChainForms, PathLines, fit_lines, move_lines, move_lines_by
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.linear import solve_symmetric
from lbacal_core.simulation.prior import SKY_HARMONICS
from lbacal_core.sky.table import harmonics_at

GAIN_WAVES = "gains along LST"
"""Under this name the notes of a report hold them."""
HARMONICS = len(read_prior()["waves"].sizes)
"""As many as the sky has waves that no model has."""


@dataclass(frozen=True)
class GainWaves:
    """Score and information of gains that follow LST.

    Attributes
    ----------
    score, information
        Those of each harmonic, cosine and sine in turn, shape (harmonic,) and (harmonic, harmonic).
    """

    score: Floats
    information: Floats

    def __add__(self, other: GainWaves) -> GainWaves:
        """Both polarisations of a station have the gains alike."""
        return GainWaves(self.score + other.score, self.information + other.information)

    @property
    def odds(self) -> float:
        """Ln of the probability of the data with such gains over that without; the number of harmonics is not known."""
        ends = np.arange(2, self.score.size + 1, 2)
        return float(logsumexp([self._odds_of(end) for end in ends.tolist()]) - np.log(ends.size))

    def _odds_of(self, number: int) -> float:
        """The same for the first harmonics."""
        score, information = self.score[:number], self.information[:number, :number]
        variance = read_prior()["event_gain"].size ** 2
        total = np.eye(number) + variance * information
        gain = variance * score @ solve_symmetric(total, score[:, None])[:, 0]
        return float(0.5 * (gain - np.linalg.slogdet(total)[1]))


def stations_that_follow(seen: Sequence[tuple[str | None, GainWaves | None]]) -> set[str | None]:
    """Stations, or None for the array, with gains likelier by as much as a mistake must be, of both polarisations."""
    total: dict[str | None, GainWaves] = {}
    for station, waves in seen:
        if waves is not None:
            total[station] = waves + total[station] if station in total else waves
    return {station for station, waves in total.items() if waves.odds > LARGEST_GAIN}


def describe_gain_waves(stations: Collection[str | None]) -> str:
    """Which stations have such gains, and what to do."""
    names = ", ".join(sorted(station or "array" for station in stations))
    return f"what {names} recorded follows sidereal time as no sky does; an investigation looks for the cause"


def waves_of_gain(lst_hours: Floats) -> Floats:
    """Cosine and sine of each harmonic in turn, shape (harmonic, event)."""
    cosines, sines = np.split(harmonics_at(lst_hours, HARMONICS)[:, 1:], 2, axis=1)
    return np.stack([cosines, sines], axis=2).reshape(len(lst_hours), -1).T


def see_gain_waves(fitted: FittedPaths, chain: ChainForms) -> GainWaves | None:
    """Fit gains along LST to the mean of a station's paths of one polarisation.

    None where P_sky is taken at its word, or where no path was fitted.
    """
    power, relative_variance, lines = fitted.power, fitted.relative_variance, fitted.lines
    if fitted.freedom is None or not len(power):
        return None
    if len(power) > 1:
        power, relative_variance = _mean_path(fitted)
        lines = fit_lines(power, fitted.sky_power, relative_variance, chain)
    is_present = np.isfinite(relative_variance[0])
    path = PathLines.of(power[0, is_present], fitted.sky_power[is_present], relative_variance[0, is_present], lines)
    return _profile_sky(path, fitted.lst_hours[is_present], fitted.freedom.search_series(fitted.dipole))


def _mean_path(fitted: FittedPaths) -> tuple[Floats, Floats]:
    """The mean of what paths record beside their lines, on the mean of these: paths that are absent change no level.

    Returns
    -------
    Its power and its relative variance, as those of one path.
    """
    power, sky, lines = fitted.power, fitted.sky_power, fitted.lines
    precision = 1.0 / fitted.relative_variance
    total = precision.sum(axis=0)
    left = np.einsum("pe,pef->ef", precision, power / lines.power(sky) - 1.0) / np.maximum(total, 1e-300)[:, None]
    model = lines.slope.mean(axis=0) * sky + lines.intercept.mean(axis=0)
    with np.errstate(divide="ignore"):
        return (model * (1.0 + left))[None], (len(power) / total)[None]


def _profile_sky(path: PathLines, lst_hours: Floats, series: Floats) -> GainWaves:
    """The score of the gains and its information, beside the lines and a sky whose modes have a variance of 1."""
    basis, waves = harmonics_at(lst_hours, SKY_HARMONICS), waves_of_gain(lst_hours)
    signal, gains = path.slope * path.of_sky, len(waves)
    flat = np.broadcast_to(waves[:, :, None], (gains, *signal.shape))
    moved = np.concatenate([move_lines_by(path, flat), move_lines(path, path.slope, basis, series)])
    # what an event shares along frequency sees of each change, shape (change, event x vector)
    shared = np.zeros((gains + len(series), path.power.shape[0], path.shared.shape[1]))
    shared[:gains] = waves[:, :, None] * path.shared.sum(axis=2)
    seen = path.shared * signal[:, None]
    # most modes are one harmonic or a few: the others are rounding
    is_there = np.abs(series).max(axis=2) > ROUNDING * np.abs(series).max()
    for h, own in enumerate(is_there.T):
        shared[gains:][own] += np.moveaxis(seen @ series[own, h].T, 2, 0) * basis[:, h, None]
    along = shared.reshape(len(shared), -1)
    information = _sum_channels(path, waves, basis, signal, series) - along @ along.T
    residual = path.power / path.model - 1.0
    dual = residual * path.weight * path.precision[:, None]
    dual -= np.einsum("evf,ev->ef", path.shared, np.einsum("evf,ef->ev", path.shared, residual))
    score = np.concatenate([waves @ dual.sum(axis=1), np.tensordot(series, basis.T @ (signal * dual), axes=2)])
    # what the lines absorb, by the weights that the products above have: those of the fit are older by a round
    onto_lines = moved @ path.information
    of_lines = np.concatenate([(dual * one).sum(axis=0) for one in (path.of_sky, path.of_constant)])
    absorbed = solve_symmetric(_information_of_lines(path), np.column_stack([onto_lines.T, of_lines]))
    information -= onto_lines @ absorbed[:, :-1]
    score -= onto_lines @ absorbed[:, -1]
    own, other = information[:gains, gains:], information[gains:, gains:] + np.eye(len(series))
    left = solve_symmetric(other, np.column_stack([own.T, score[gains:]]))
    return GainWaves(score[:gains] - own @ left[:, -1], information[:gains, :gains] - own @ left[:, :-1])


def _information_of_lines(path: PathLines) -> Floats:
    """That of slopes and intercepts, shape (2 freq, 2 freq)."""
    weight, columns = path.weight * path.precision[:, None], np.stack([path.of_sky, path.of_constant])
    of_channels = np.einsum("aef,bef,ef->abf", columns, columns, weight)
    events, vectors, channels = path.shared.shape
    shared = np.moveaxis(path.shared * columns[:, :, None], 0, 2).reshape(events * vectors, 2 * channels)
    found = -(shared.T @ shared)
    at = np.arange(channels)
    for a in range(2):
        for b in range(2):
            found[a * channels + at, b * channels + at] += of_channels[a, b]
    return found


def _sum_channels(path: PathLines, waves: Floats, basis: Floats, signal: Floats, series: Floats) -> Floats:
    """Products of all changes in the noise of single channels, shape (change, change): gains first, then the sky.

    A change of the sky is a sum of harmonics times spectra, so that sums over events are made of the harmonics.
    """
    weight = path.weight * path.precision[:, None]
    harmonics, events = basis.shape[1], len(basis)
    of_sky = np.einsum("eh,eg->hge", basis, basis).reshape(-1, events) @ (weight * signal**2)
    onto = series.transpose(2, 0, 1) @ of_sky.T.reshape(-1, harmonics, harmonics)
    between = np.tensordot(onto.transpose(1, 2, 0), series, axes=((1, 2), (1, 2)))
    both = np.einsum("ke,eh->khe", waves, basis).reshape(-1, events) @ (weight * signal)
    mixed = np.tensordot(both.reshape(len(waves), harmonics, -1), series, axes=((1, 2), (1, 2)))
    alone = (waves * weight.sum(axis=1)) @ waves.T
    return np.block([[alone, mixed], [mixed.T, between]])
