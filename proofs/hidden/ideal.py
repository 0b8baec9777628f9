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
from dataclasses import dataclass, replace
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
class PathChains:
    """The chain of every path, as a fit leaves it free: (sky + n_lna) front + n_rcu receiver + n_adc.

    Attributes
    ----------
    sky, receiver
        Known, shape (path, event, freq).
    front
        G_ant A g L G_RCU S, shape (path, event, freq); a fit moves each channel of a path by one factor.
    n_lna, n_rcu, n_adc
        Shape (path, 1, 1).
    """

    sky: Floats
    receiver: Floats
    front: Floats
    n_lna: Floats
    n_rcu: Floats
    n_adc: Floats

    @cached_property
    def power(self) -> Floats:
        """Shape (path, event, freq)."""
        return np.asarray((self.sky + self.n_lna) * self.front + self.n_rcu * self.receiver + self.n_adc)

    @cached_property
    def columns(self) -> tuple[Floats, Floats]:
        """Relative changes of the power by what is free.

        By ln A in a channel, shape (path, event, freq), nonzero in that channel; by N_LNA, N_RCU and N_ADC, shape
        (3, path, event, freq).
        """
        front = self.front / self.power
        return (self.sky + self.n_lna) * front, np.stack([front, self.receiver / self.power, 1.0 / self.power])

    def moved(self, slopes: Floats, constants: Floats) -> PathChains:
        """After a step in ln A, shape (path, freq), and in the constants, shape (path, 3)."""
        n_lna, n_rcu, n_adc = (constants[:, k, None, None] for k in range(3))
        front = self.front * (1.0 + slopes[:, None, :])
        return replace(self, front=front, n_lna=self.n_lna + n_lna, n_rcu=self.n_rcu + n_rcu, n_adc=self.n_adc + n_adc)


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
    chains
        The chain about which the fit is linear: the true one without faults, or one fitted to data with them.
    """

    station: DrawnStation
    noise: Noise
    departure: Floats
    chains: PathChains

    def power(self, faults: Sequence[Fault]) -> Floats:
        """The expected power with faults, shape (path, event, freq)."""
        return self._paths(expected_power(self.station.stages, self.station.scene, faults))

    def template(self, faults: Sequence[Fault]) -> Floats:
        """Relative change of the expected power, shape (path, event, freq)."""
        return np.asarray(self.power(faults) / self.power(()) - 1.0)

    def information(self, templates: Floats) -> Floats:
        """Inner products of templates less what the fit absorbs, shape (k, path, event, freq) -> (k, k).

        The root of the diagonal is the SNR; the correlation of two signatures is that of a covariance.
        """
        weighed = self.noise.weigh(templates)
        absorbed = self._onto_columns(weighed)
        total = np.einsum("kpef,lpef->kl", templates, weighed, optimize=True)
        return np.asarray(total - absorbed @ cho_solve(self._normal_factor, absorbed.T))

    def fitted_to(self, power: Floats) -> IdealDetector:
        """The detector about the chains that fit a power best, shape (path, event, freq); Newton's first step."""
        onto = self._onto_columns(self.noise.weigh((power / self.chains.power - 1.0)[None]))[0]
        step = (cho_solve(self._normal_factor, onto) * self._scale).reshape(len(power), -1)
        return replace(self, chains=self.chains.moved(step[:, :-3], step[:, -3:]))

    def chi_squared(self, power: Floats) -> float:
        """Chi^2 of a power about the chains that fit it best."""
        best = self.fitted_to(power)
        return float(best.information((power / best.chains.power - 1.0)[None])[0, 0])

    def snr(self, faults: Sequence[Fault]) -> float:
        """Ideal signal-to-noise ratio of faults that act together."""
        return float(np.sqrt(max(self.chi_squared(self.power(faults)), 0.0)))

    def information_together(self, faults: Sequence[Fault]) -> Floats:
        """Inner products of what each of some faults adds to the others, shape (fault, fault)."""
        everything = self.power(faults)
        best = self.fitted_to(everything)
        without = [self.power([other for other in faults if other is not one]) for one in faults]
        return best.information((everything - np.stack(without)) / best.chains.power)

    def snr_against_others(self, fault: Fault, antenna: int) -> float:
        """Ideal SNR of a static fault of one antenna's front gain, against the antennas of the same cable."""
        scene = self.station.scene
        changed = np.log(_front(fault.alter(self.station.stages, scene)) / _front(self.station.stages))
        seen_of_path = np.broadcast_to(changed, (len(scene.antennas), len(DIPOLES), *changed.shape[2:])).mean(axis=2)
        channels = seen_of_path.shape[2]
        own = scene.antennas == antenna
        others = (scene.cables == scene.cables[own][0]) & ~own
        contrast = own.astype(float) - others / others.sum()
        share = np.repeat(contrast, len(DIPOLES)) / len(DIPOLES)
        covariance = np.einsum("p,pfqg,q->fg", share, self._slope_covariance, share, optimize=True)
        covariance = covariance + np.sum(share**2) * self.departure
        free_gain = 1e3 * np.trace(covariance) * np.ones((channels, channels))
        seen = np.einsum("p,pf->f", share, seen_of_path.reshape(-1, channels))
        return float(np.sqrt(seen @ np.linalg.solve(covariance + free_gain, seen)))

    def _paths(self, stage: Floats) -> Floats:
        return _of_paths(stage, self.station.scene)

    def _onto_columns(self, weighed: Floats) -> Floats:
        """Products of vectors (k, path, event, freq) with the columns, shape (k, path x column)."""
        slopes, constants = self.chains.columns
        of_slopes = np.einsum("pef,kpef->kpf", slopes, weighed)
        of_constants = np.einsum("cpef,kpef->kpc", constants, weighed, optimize=True)
        joined = np.concatenate([of_slopes, of_constants], axis=2).reshape(len(weighed), -1)
        return np.asarray(joined * self._scale)

    @cached_property
    def _normal(self) -> Floats:
        """N' V^-1 N, shape (path x column, path x column), path pair by path pair."""
        slopes, constants = self.chains.columns
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
        paths, _, channels = self.chains.columns[0].shape
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
    stages, scene = station.stages, station.scene
    known = {
        name: _of_paths(values, scene)
        for name, values in {"sky": stages.sky, "receiver": stages.receiver, "front": _front(stages)}.items()
    }
    constants = {
        name: _of_paths(values, scene)[:, :1, :1]
        for name, values in {
            "n_lna": stages.lna_noise, "n_rcu": stages.rcu_noise, "n_adc": stages.adc_noise,
        }.items()
    }  # fmt: skip
    return IdealDetector(station, noise, nuisances.departures**2 / 2 * wave @ wave.T, PathChains(**known, **constants))


def _of_paths(stage: Floats, scene: Scene) -> Floats:
    """A stage of the chain for every path, shape (path, event, freq)."""
    shape = (len(scene.antennas), len(DIPOLES), len(scene.time_unix), len(scene.frequency_mhz))
    return np.broadcast_to(stage, shape).reshape(-1, *shape[2:])


def _front(stages: Stages) -> Floats:
    return stages.gain * stages.antenna * stages.cable * stages.receiver
