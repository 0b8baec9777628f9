"""The ideal detector: what a planted fault could show at best, computed from the twin's truth alone.

It knows the exact template d = P(with)/P(without) - 1 of every path, event and channel, the exact covariance V of the
noise, and everything that the fit leaves free (N: per path A(nu) in each channel, N_LNA, N_RCU and N_ADC). By
generalised least squares the signal-to-noise ratio of a fault is

    SNR^2 = d' V^-1 d - (N' V^-1 d)' (N' V^-1 N)^-1 (N' V^-1 d).

Static departures of one antenna's cable are absorbed by its A(nu) to the last digit. What is left of them is the
comparison with the other antennas of the same cable: SNR^2 = t' C^-1 t, with t the change of ln A(nu) and C the
covariance of the fitted ln A(nu) of the antenna (mean of its dipoles) less the mean of the others, a gain that is flat
along frequency left free (`snr_against_others`).

No code is shared with what searches (`lbacal_core.discovery`, `lbacal_core.causes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import DrawnStation, expected_power
from lbacal_core.twin.faults.fault import Fault
from lbacal_core.twin.nuisances import Nuisances
from lbacal_core.twin.settings import TwinSettings
from lbacal_core.twin.stages import Scene, Stages

TINY_RIDGE = 1e-13
"""On columns of unit norm: keeps the columns of a path without spectra from being singular, and moves nothing else."""


@dataclass(frozen=True)
class Noise:
    """Inverse covariance of the relative noise of one station, event by event; zero where a spectrum is absent.

    All channels are alike and correlated by what is flat in frequency only, so that the band mean and the deviations
    from it are independent.

    Attributes
    ----------
    rest
        Of deviations from the band mean, in each channel, shape (event, path, path).
    band
        Of the band mean times the root of the number of channels, shape (event, path, path).
    """

    rest: Floats
    band: Floats

    def weigh(self, values: Floats) -> Floats:
        """V^-1 times vectors of shape (..., path, event, freq)."""
        mean = values.mean(axis=-1)
        weighed = np.einsum("epq,...qef->...pef", self.rest, values, optimize=True)
        return np.asarray(weighed + np.einsum("epq,...qe->...pe", self.band - self.rest, mean)[..., None])


def noise_of(
    settings: TwinSettings, nuisances: Nuisances, station: str, blocks: NDArray[np.int64], channels: int
) -> Noise:
    """The noise that the twin draws, to first order in its relative size.

    Radiometer noise of each path and channel, a part of it shared by the antennas of a dipole letter; the gain of an
    event, of the station and of each path. Products of two (0.3 % of the radiometer's variance) are left out.

    Parameters
    ----------
    blocks
        Averaged blocks, 0 where there is no spectrum, shape (path, event); paths in the order 0 X, 0 Y, 1 X, 1 Y, ...
    """
    factor = nuisances.noise_factor if station in nuisances.noisy_stations else 1.0
    is_present = (blocks > 0).T
    amplitude = factor * settings.radiometer * np.sqrt(100.0 / np.maximum(blocks, 1).T)
    letter = np.arange(len(blocks)) % len(DIPOLES)
    shape = np.where(letter[:, None] == letter, nuisances.sky_correlation, 0.0)
    shape[np.diag_indices_from(shape)] = 1.0
    rest = shape * amplitude[:, :, None] * amplitude[:, None, :]
    gain = settings.event_gain_common**2 + settings.event_gain_path**2 * np.eye(len(blocks))
    return Noise(*(_invert_present(part, is_present) for part in (rest, rest + channels * factor**2 * gain)))


def _invert_present(covariance: Floats, is_present: NDArray[np.bool_]) -> Floats:
    both = is_present[:, :, None] & is_present[:, None, :]
    padded = np.where(both, covariance, np.eye(covariance.shape[1]))
    return np.asarray(np.linalg.inv(padded) * both)


def count_blocks(spectra: Spectra, scene: Scene) -> NDArray[np.int64]:
    """Averaged blocks of every path and event of a station, 0 where there is no spectrum; shape (path, event)."""
    rows = np.flatnonzero(spectra.station == scene.station)
    antenna = np.searchsorted(scene.antennas, spectra.antenna[rows])
    dipole = np.array([DIPOLES.index(str(letter)) for letter in spectra.dipole[rows]])
    event = np.searchsorted(scene.time_unix, spectra.time_unix[rows])
    blocks = np.zeros((len(scene.antennas), len(DIPOLES), len(scene.time_unix)), dtype=np.int64)
    blocks[antenna, dipole, event] = spectra.blocks[rows]
    return blocks.reshape(-1, blocks.shape[2])


@dataclass(frozen=True)
class IdealDetector:
    """What could be seen of a fault in one station's data by who knows everything but its size.

    Attributes
    ----------
    station
        The twin's station before its noise.
    noise
        The noise of the spectra that exist.
    departure
        Covariance by which ln A(nu) of each path departs from that of the next, shape (freq, freq); 0 where paths are
        alike.
    """

    station: DrawnStation
    noise: Noise
    departure: Floats

    def template(self, faults: Sequence[Fault]) -> Floats:
        """Relative change of the expected power, shape (path, event, freq)."""
        with_faults = expected_power(self.station.stages, self.station.scene, faults)
        return np.asarray(self._paths(with_faults) / self._plain - 1.0)

    def information(self, templates: Floats) -> Floats:
        """Inner products of templates less what the fit absorbs, shape (k, path, event, freq) -> (k, k).

        The root of the diagonal is the SNR; the correlation of two signatures is that of a covariance.
        """
        weighed = self.noise.weigh(templates)
        absorbed = self._onto_columns(weighed)
        total = np.einsum("kpef,lpef->kl", templates, weighed, optimize=True)
        return np.asarray(total - absorbed @ cho_solve(self._normal_factor, absorbed.T))

    def snr(self, faults: Sequence[Fault]) -> float:
        """Ideal signal-to-noise ratio of faults that act together."""
        return float(np.sqrt(np.maximum(self.information(self.template(faults)[None])[0, 0], 0.0)))

    def snr_against_others(self, fault: Fault, antenna: int) -> float:
        """Ideal SNR of a static fault of one antenna's front gain, against the antennas of the same cable."""
        scene = self.station.scene
        changed = np.log(_front(fault.alter(self.station.stages, scene)) / _front(self.station.stages))
        shape = np.broadcast_to(changed, (*self._plain_shape[:2], *changed.shape[2:])).mean(axis=2)
        channels = shape.shape[2]
        own = scene.antennas == antenna
        others = (scene.cables == scene.cables[own][0]) & ~own
        contrast = own.astype(float) - others / others.sum()
        share = np.repeat(contrast, len(DIPOLES)) / len(DIPOLES)
        covariance = np.einsum("p,pfqg,q->fg", share, self._slope_covariance, share, optimize=True)
        covariance = covariance + np.sum(share**2) * self.departure
        free_gain = 1e3 * np.trace(covariance) * np.ones((channels, channels))
        seen = np.einsum("p,pf->f", share, shape.reshape(-1, channels))
        return float(np.sqrt(seen @ np.linalg.solve(covariance + free_gain, seen)))

    @property
    def _plain_shape(self) -> tuple[int, ...]:
        scene = self.station.scene
        return (len(scene.antennas), len(DIPOLES), len(scene.time_unix), len(scene.frequency_mhz))

    def _paths(self, stage: Floats) -> Floats:
        """A stage of the chain for every path, shape (path, event, freq)."""
        shape = self._plain_shape
        return np.broadcast_to(stage, shape).reshape(-1, *shape[2:])

    @cached_property
    def _plain(self) -> Floats:
        return self._paths(expected_power(self.station.stages, self.station.scene, ()))

    @cached_property
    def _columns(self) -> tuple[Floats, Floats]:
        """What a path's fit leaves free, as relative changes of its power, scaled to similar size.

        Of ln A in a channel, shape (path, event, freq), nonzero in that channel; of the noise constants, shape
        (constant, path, event, freq).
        """
        stages = self.station.stages
        front = self._paths(_front(stages)) / self._plain
        sky = self._paths(stages.sky + stages.lna_noise)
        constants = np.stack([front, self._paths(stages.receiver) / self._plain, 1.0 / self._plain])
        constants /= np.sqrt(np.mean(constants**2, axis=(2, 3), keepdims=True))
        return sky * front, constants

    def _onto_columns(self, weighed: Floats) -> Floats:
        """Products of vectors (k, path, event, freq) with the columns, shape (k, path x column)."""
        slopes, constants = self._columns
        of_slopes = np.einsum("pef,kpef->kpf", slopes, weighed)
        of_constants = np.einsum("cpef,kpef->kpc", constants, weighed, optimize=True)
        joined = np.concatenate([of_slopes, of_constants], axis=2).reshape(len(weighed), -1)
        return np.asarray(joined * self._scale)

    @cached_property
    def _normal(self) -> Floats:
        """N' V^-1 N, shape (path x column, path x column), path pair by path pair."""
        slopes, constants = self._columns
        paths, _, channels = slopes.shape
        size = channels + len(constants)
        normal = np.empty((paths, size, paths, size))
        band = constants.sum(axis=3)
        flat = (self.noise.band - self.noise.rest) / channels
        for p in range(paths):
            for q in range(p, paths):
                rest, extra = self.noise.rest[:, p, q, None], flat[:, p, q, None]
                block = np.empty((size, size))
                block[:channels, :channels] = slopes[p].T @ (extra * slopes[q])
                block[np.arange(channels), np.arange(channels)] += np.sum(slopes[p] * rest * slopes[q], axis=0)
                for (i, a), (j, b) in (((p, slopes[p] * rest), (q, extra)), ((q, slopes[q] * rest), (p, extra))):
                    mixed = np.einsum("ef,cef->fc", a, constants[:, j]) + slopes[i].T @ (b * band[:, j].T)
                    if i == p:
                        block[:channels, channels:] = mixed
                    if i == q:
                        block[channels:, :channels] = mixed.T
                own = np.einsum("cef,def->cd", constants[:, p] * rest, constants[:, q])
                block[channels:, channels:] = own + band[:, p] @ (extra * band[:, q].T)
                normal[p, :, q], normal[q, :, p] = block, block.T
        return normal.reshape(paths * size, paths * size)

    @cached_property
    def _scale(self) -> Floats:
        """What brings every column to unit norm; 0 for those of a path without spectra."""
        norm = np.sqrt(np.diag(self._normal))
        return np.asarray(np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0))

    @cached_property
    def _normal_factor(self) -> tuple[Floats, bool]:
        scaled = self._normal * self._scale * self._scale[:, None]
        scaled[np.diag_indices_from(scaled)] = 1.0 + TINY_RIDGE
        factor: tuple[Floats, bool] = cho_factor(scaled)
        return factor

    @cached_property
    def _slope_covariance(self) -> Floats:
        """Covariance of the fitted ln A(nu) of all paths, shape (path, freq, path, freq)."""
        paths, _, channels = self._columns[0].shape
        inverse = cho_solve(self._normal_factor, np.diag(self._scale)) * self._scale[:, None]
        return np.asarray(inverse.reshape(paths, -1, paths, channels + 3)[:, :channels, :, :channels])


def ideal_detector(
    settings: TwinSettings, nuisances: Nuisances, station: DrawnStation, spectra: Spectra
) -> IdealDetector:
    """The ideal detector of one station of a campaign."""
    blocks = count_blocks(spectra, station.scene)
    channels = len(station.scene.frequency_mhz)
    noise = noise_of(settings, nuisances, station.scene.station, blocks, channels)
    wave = np.cos(np.pi * np.outer(np.linspace(0.0, 1.0, channels), [1, 2, 3, 4]))
    return IdealDetector(station, noise, nuisances.departures**2 / 2 * wave @ wave.T)


def _front(stages: Stages) -> Floats:
    return stages.gain * stages.antenna * stages.cable * stages.receiver
