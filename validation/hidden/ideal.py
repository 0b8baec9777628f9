"""The ideal detector: what a planted fault could show at best, computed from the twin's truth alone.

It knows the exact template d = P(with)/P(without) - 1 of every path, event and channel, the exact covariance V of the
noise, and everything that the fit leaves free (N: per path A(nu) in each channel, N_LNA, N_RCU and N_ADC). By
generalised least squares the signal-to-noise ratio of a fault is

    SNR^2 = d' V^-1 d - (N' V^-1 d)' (N' V^-1 N)^-1 (N' V^-1 d).

Static departures of one antenna's cable are absorbed by its A(nu) to the last digit. What is left of them is the
comparison with the other antennas of the same cable, or of a whole cable name with the others: SNR^2 = t' C^-1 t, with
t the change of ln A(nu) and C the covariance of the fitted ln A(nu) of the antenna (mean of its dipoles) less the mean
of the others, a gain that is flat along frequency left free (`snr_against_others`).

Where the finder's sky is its own, it also leaves free how other models of sky and antenna differ from it: these modes
of ln P_sky, each with a prior of one standard deviation, count as free here too.

No code is shared with what searches (`lbacal_core.discovery`, `lbacal_core.causes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import DrawnStation, expected_power
from lbacal_twin.faults.fault import Fault
from lbacal_twin.gains import BEHIND_EVERYTHING, EventGains
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.settings import TwinSettings
from validation.hidden.noise import Noise, count_blocks, noise_of, slope_of_resonance

TINY_RIDGE = 1e-13
"""On columns of unit norm: keeps the columns of a path without spectra from being singular, and moves nothing else."""
MOST_STEPS = 8
STEADY = 0.01
"""Newton's steps end where one changes chi^2 by less than this part of (1 + chi^2)."""


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
    def sky_share(self) -> Floats:
        """Part of the power that is the sky's, shape (path, event, freq)."""
        return np.asarray(self.sky * self.front / self.power)

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
    """The largest possible SNR of a fault in one station's data, by a detector that knows everything but its size.

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
    modes
        Changes of ln P_sky that the finder leaves free, each one standard deviation of its prior, shape
        (mode, dipole, event, freq); none where the sky power is taken at its word.
    """

    station: DrawnStation
    noise: Noise
    departure: Floats
    chains: PathChains
    modes: Floats

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
        told, hidden = self._information(templates)
        return told - hidden

    def _information(self, templates: Floats) -> tuple[Floats, Floats]:
        """Inner products of templates where the sky power is taken at its word, and what free modes take of them."""
        weighed = self.noise.weigh(templates)
        absorbed = self._onto_columns(weighed)
        solved = cho_solve(self._normal_factor, absorbed.T)
        total = np.einsum("kpef,lpef->kl", templates, weighed, optimize=True) - absorbed @ solved
        if not len(self.modes):
            return np.asarray(total), np.zeros_like(total)
        onto_modes, of_modes = self._mode_products
        mixed = self._onto_modes(weighed) - (onto_modes @ solved).T
        return np.asarray(total), np.asarray(mixed @ np.linalg.solve(of_modes, mixed.T))

    def fitted_to(self, power: Floats) -> IdealDetector:
        """The detector about the chains that fit a power best, shape (path, event, freq).

        One of Newton's steps is not enough where the power is far from the chain: a compression that the best chain
        leaves at an SNR of 8.2 is at 9.5 after it.
        """
        best, chi_squared = self, np.inf
        for _ in range(MOST_STEPS):
            before, best = chi_squared, best._stepped_to(power)
            chi_squared = best.left_of(power)
            if abs(before - chi_squared) < STEADY * (1.0 + chi_squared):
                break
        return best

    def _stepped_to(self, power: Floats) -> IdealDetector:
        onto = self._onto_columns(self.noise.weigh((power / self.chains.power - 1.0)[None]))[0]
        step = (cho_solve(self._normal_factor, onto) * self._scale).reshape(len(power), -1)
        return replace(self, chains=self.chains.moved(step[:, :-3], step[:, -3:]))

    def left_of(self, power: Floats) -> float:
        """Chi^2 of a power to first order about these chains."""
        return float(self.information((power / self.chains.power - 1.0)[None])[0, 0])

    def chi_squared(self, power: Floats) -> float:
        """Chi^2 of a power about the chains that fit it best."""
        return self.fitted_to(power).left_of(power)

    def snr(self, faults: Sequence[Fault]) -> float:
        """Ideal signal-to-noise ratio of faults that act together."""
        return float(np.sqrt(max(self.chi_squared(self.power(faults)), 0.0)))

    def linear_snr(self, faults: Sequence[Fault]) -> float:
        """The same to first order, about the chains without faults: enough for small ones, and much cheaper."""
        return float(np.sqrt(max(float(self.information(self.template(faults)[None])[0, 0]), 0.0)))

    def share_left(self, faults: Sequence[Fault]) -> float:
        """Part of the information on faults that the freedom of the sky and antenna models leaves, 0 to 1."""
        told, hidden = (float(part[0, 0]) for part in self._information(self.template(faults)[None]))
        return 1.0 - hidden / told if told > 0 else 0.0

    def information_together(self, faults: Sequence[Fault]) -> Floats:
        """Inner products of what each of some faults adds to the others, shape (fault, fault)."""
        everything = self.power(faults)
        best = self.fitted_to(everything)
        without = [self.power([other for other in faults if other is not one]) for one in faults]
        return best.information((everything - np.stack(without)) / best.chains.power)

    def snr_against_others(self, fault: Fault) -> float:
        """Ideal SNR of a static fault of the front gain of some antennas against others.

        Those are the others of the same cable name; of a whole cable name all antennas with other cables.
        """
        scene = self.station.scene
        changed = np.log(_front(fault.alter(self.station.stages, scene)) / _front(self.station.stages))
        seen_of_path = np.broadcast_to(changed, (len(scene.antennas), len(DIPOLES), *changed.shape[2:])).mean(axis=2)
        channels = seen_of_path.shape[2]
        own = fault.where.mask(scene)[:, 0, 0, 0] > 0
        others = np.isin(scene.cables, scene.cables[own]) & ~own
        others = others if np.any(others) else ~own
        contrast = own / own.sum() - others / others.sum()
        share = np.repeat(contrast, len(DIPOLES)) / len(DIPOLES)
        covariance = np.einsum("p,pfqg,q->fg", share, self._slope_covariance, share, optimize=True)
        covariance = covariance + np.sum(share**2) * self.departure
        moved = np.einsum("p,mpf->mf", share, self._moved_by_modes)
        covariance = covariance + moved.T @ moved
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

    def _onto_modes(self, weighed: Floats) -> Floats:
        """Products of vectors (k, path, event, freq) with the modes, shape (k, mode)."""
        shown = (weighed * self.chains.sky_share).reshape(len(weighed), -1, len(DIPOLES), *weighed.shape[2:])
        return np.tensordot(shown.sum(axis=1), self.modes, axes=((1, 2, 3), (1, 2, 3)))

    @cached_property
    def _mode_products(self) -> tuple[Floats, Floats]:
        """Products of the modes with the columns, and with each other less what the columns absorb, prior included.

        Event by event a mode is a few numbers, which the paths of a polarisation show by their shares of the sky.
        """
        (slopes, constants), modes, share = self.chains.columns, self.modes, self.chains.sky_share
        dipole = np.arange(len(share)) % len(DIPOLES)
        rest = self.noise.rest
        weighed = np.stack(
            [(rest[:, :, dipole == d] @ share[dipole == d].swapaxes(0, 1)).swapaxes(0, 1) for d in range(len(DIPOLES))]
        )
        of_slopes = (slopes * weighed).transpose(0, 3, 1, 2) @ modes.transpose(1, 3, 2, 0)
        of_constants = np.tensordot(constants[:, None] * weighed, modes, axes=((1, 3, 4), (1, 2, 3)))
        onto = np.concatenate([of_slopes.sum(axis=0).swapaxes(0, 1), of_constants.swapaxes(0, 1)], axis=1)
        between = (share * weighed).reshape(len(DIPOLES), -1, len(DIPOLES), *share.shape[1:]).sum(axis=1)
        shown = np.einsum("cdef,mdef->mcef", between, modes)
        among = np.tensordot(modes, shown, axes=((1, 2, 3), (1, 2, 3)))
        onto = onto.reshape(len(slopes), -1, len(modes))
        for paths, of_columns, of_modes in self.noise.projections(slopes, constants, share, modes):
            onto[paths] -= (of_columns.T @ of_modes).reshape(onto[paths].shape)
            among -= of_modes.T @ of_modes
        onto = onto.reshape(-1, len(modes)).T * self._scale
        return onto, among - onto @ cho_solve(self._normal_factor, onto.T) + np.eye(len(onto))

    @cached_property
    def _normal(self) -> Floats:
        """N' V^-1 N, shape (path x column, path x column)."""
        slopes, constants = self.chains.columns
        paths, _, channels = slopes.shape
        size, kinds = channels + len(constants), 1 + len(constants)
        normal = np.zeros((paths, size, paths, size))
        columns = np.concatenate([slopes[None], constants]).transpose(3, 2, 1, 0)
        at, more = np.arange(channels), slice(channels, None)
        for p in range(paths):  # the noise between paths of different dipoles is 0
            others = np.arange(p, paths, len(DIPOLES))
            weighed = columns[:, :, others] * self.noise.rest[:, p, others, None]
            block = columns[:, :, p].swapaxes(1, 2) @ weighed.reshape(channels, len(weighed[0]), -1)
            block = block.reshape(channels, kinds, others.size, kinds)
            normal[p, at, others[:, None], at] = block[:, 0, :, 0].T
            normal[p, :channels, others, more] = block[:, 0, :, 1:].swapaxes(0, 1)
            normal[p, more, others, :channels] = block[:, 1:, :, 0].transpose(2, 1, 0)
            normal[p, more, others, more] = block[:, 1:, :, 1:].sum(axis=0).swapaxes(0, 1)
            normal[others, :, p] = normal[p][:, others].transpose(1, 2, 0)
        for shown, taken, _ in self.noise.projections(slopes, constants, self.chains.sky_share, self.modes[:0]):
            own = normal[shown, :, shown]
            own -= (taken.T @ taken).reshape(own.shape)
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
    def _moved_by_modes(self) -> Floats:
        """Change of the fitted ln A(nu) of all paths by each mode of the sky, shape (mode, path, freq)."""
        paths, _, channels = self.chains.columns[0].shape
        if not len(self.modes):
            return np.empty((0, paths, channels))
        moved = cho_solve(self._normal_factor, self._mode_products[0].T).T * self._scale
        return np.asarray(moved.reshape(len(self.modes), paths, -1)[:, :, :channels])

    @cached_property
    def _slope_covariance(self) -> Floats:
        """Covariance of the fitted ln A(nu) of all paths, shape (path, freq, path, freq)."""
        paths, _, channels = self.chains.columns[0].shape
        inverse = cho_solve(self._normal_factor, np.diag(self._scale)) * self._scale[:, None]
        return np.asarray(inverse.reshape(paths, -1, paths, channels + 3)[:, :channels, :, :channels])


def ideal_detector(
    settings: TwinSettings,
    nuisances: Nuisances,
    station: DrawnStation,
    spectra: Spectra,
    gains: EventGains = BEHIND_EVERYTHING,
    modes: Floats | None = None,
) -> IdealDetector:
    """The ideal detector of one station of a campaign."""
    stages, scene = station.stages, station.scene
    chains = chains_of(stages, scene)
    noise = noise_of(
        settings,
        nuisances,
        scene.station,
        count_blocks(spectra, scene),
        chains.columns[0],
        slope_of_resonance(stages, scene.frequency_mhz),
        gains.jitters_at(scene)[:, 0],
        gains,
    )
    wave = np.cos(np.pi * np.outer(np.linspace(0.0, 1.0, len(scene.frequency_mhz)), [1, 2, 3, 4]))
    none = np.empty((0, len(DIPOLES), len(scene.time_unix), len(scene.frequency_mhz)))
    departure = nuisances.departures**2 / 2 * wave @ wave.T
    return IdealDetector(station, noise, departure, chains, none if modes is None else modes)


def chains_of(stages: Stages, scene: Scene) -> PathChains:
    """The chain of every path as the fit has it."""
    known = {"sky": stages.sky, "receiver": stages.receiver, "front": _front(stages)}
    constants = {"n_lna": stages.lna_noise, "n_rcu": stages.rcu_noise, "n_adc": stages.adc_noise}
    return PathChains(
        **{name: _of_paths(values, scene) for name, values in known.items()},
        **{name: _of_paths(values, scene)[:, :1, :1] for name, values in constants.items()},
    )


def _of_paths(stage: Floats, scene: Scene) -> Floats:
    """A stage of the chain for every path, shape (path, event, freq)."""
    shape = (len(scene.antennas), len(DIPOLES), len(scene.time_unix), len(scene.frequency_mhz))
    return np.broadcast_to(stage, shape).reshape(-1, *shape[2:])


def _front(stages: Stages) -> Floats:
    return stages.gain * stages.antenna * stages.cable * stages.receiver
