"""The noise that the twin draws, as its covariance: radiometer noise, and the gains of events wherever they act.

In one event the covariance over paths and channels is V = R x 1 + sum_k u_k u_k', with R the radiometer noise between
paths, alike in every channel, and u_k a gain that moves all paths together or one path by itself, as it shows along
frequency. Its inverse follows from that of R (Woodbury 1950).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.spectra import Spectra
from lbacal_core.twin.gains import BEHIND_EVERYTHING, EventGains
from lbacal_core.twin.nuisances import Nuisances
from lbacal_core.twin.settings import TwinSettings
from lbacal_core.twin.stages import Scene, Stages

EVENTS_TOGETHER = 64
"""Events whose projections are in memory at the same time."""


@dataclass(frozen=True)
class Noise:
    """Covariance of the relative noise of one station, event by event; its inverse is 0 where a spectrum is absent.

    Attributes
    ----------
    rest
        Inverse of R, shape (event, path, path).
    common
        Gains that all paths share, shape (gain, path, event, freq); 0 where a spectrum is absent.
    own
        Gains of each path by itself, shape (gain, path, event, freq).
    """

    rest: Floats
    common: Floats
    own: Floats

    def weigh(self, values: Floats) -> Floats:
        """V^-1 times vectors of shape (..., path, event, freq)."""
        weighed = np.einsum("epq,...qef->...pef", self.rest, values, optimize=True)
        together = np.einsum("kpef,...pef->...ek", self.common, weighed, optimize=True)
        alone = np.einsum("jpef,...pef->...ejp", self.own, weighed, optimize=True)
        onto = np.concatenate([together, alone.reshape(*alone.shape[:-2], -1)], axis=-1)
        taken = np.einsum("ekl,...el->...ek", self._inverse, onto, optimize=True)
        count = len(self.common)
        back = np.einsum("kpef,...ek->...pef", self.common, taken[..., :count], optimize=True)
        shares = taken[..., count:].reshape(alone.shape)
        back = back + np.einsum("jpef,...ejp->...pef", self.own, shares, optimize=True)
        return np.asarray(weighed - np.einsum("epq,...qef->...pef", self.rest, back, optimize=True))

    def projections(self, slopes: Floats, constants: Floats) -> Iterator[Floats]:
        """What the gains take of the columns of a fit, some events at a time: V^-1 = R^-1 - W'W in these columns.

        Parameters
        ----------
        slopes, constants
            As `PathChains.columns`.

        Returns
        -------
        W for some events, shape (event x gain, path x column).
        """
        paths, _, channels = slopes.shape
        for at, root, seen in self._gains_by_event():
            onto = np.empty((*seen.shape[:3], channels + len(constants)))
            onto[..., :channels] = seen * slopes[:, at].transpose(1, 0, 2)[:, None]
            onto[..., channels:] = np.einsum("ekpf,cpef->ekpc", seen, constants[:, :, at], optimize=True)
            columns = onto.reshape(*seen.shape[:2], paths * onto.shape[3])
            yield np.asarray((root @ columns).reshape(-1, columns.shape[2]), dtype=np.float64)

    def projections_of_modes(self, share: Floats, modes: Floats) -> Iterator[Floats]:
        """The same of changes of the sky, shape (mode, dipole, event, freq), of which paths show a share each.

        Returns
        -------
        W for some events, shape (event x gain, mode).
        """
        for at, root, seen in self._gains_by_event():
            shown = seen * share[:, at].transpose(1, 0, 2)[:, None]
            shown = shown.reshape(*seen.shape[:2], -1, len(DIPOLES), seen.shape[3]).sum(axis=2)
            by_event = modes[:, :, at].transpose(2, 1, 3, 0).reshape(len(seen), -1, len(modes))
            yield np.asarray((root @ (shown.reshape(*seen.shape[:2], -1) @ by_event)).reshape(-1, len(modes)))

    def _gains_by_event(self) -> Iterator[tuple[slice, Floats, Floats]]:
        """Some events at a time, the root of `_inverse` and U' R^-1, shape (event, gain, path, freq)."""
        paths, events, channels = self.common.shape[1:]
        root = np.asarray(np.linalg.cholesky(self._inverse).transpose(0, 2, 1), dtype=np.float64)
        for begin in range(0, events, EVENTS_TOGETHER):
            at = slice(begin, min(begin + EVENTS_TOGETHER, events))
            rest = self.rest[at]
            together = np.einsum("epq,kqef->ekpf", rest, self.common[:, :, at], optimize=True)
            alone = np.einsum("eqp,jpef->ejpqf", rest, self.own[:, :, at], optimize=True)
            yield at, root[at], np.concatenate([together, alone.reshape(len(rest), -1, paths, channels)], axis=1)

    @cached_property
    def _inverse(self) -> Floats:
        """(1 + U' R^-1 U)^-1, shape (event, gain, gain)."""
        count, each, paths = len(self.common), len(self.own), self.rest.shape[1]
        events = len(self.rest)
        weighed = np.einsum("epq,kqef->kpef", self.rest, self.common, optimize=True)
        whole = np.empty((events, count + each * paths, count + each * paths))
        whole[:, :count, :count] = np.einsum("kpef,lpef->ekl", self.common, weighed, optimize=True)
        mixed = np.einsum("jpef,kpef->ejpk", self.own, weighed, optimize=True)
        mixed = mixed.reshape(events, each * paths, count)
        whole[:, count:, :count], whole[:, :count, count:] = mixed, mixed.transpose(0, 2, 1)
        products = np.einsum("jpef,iqef->ejpiq", self.own, self.own, optimize=True)
        products *= self.rest[:, None, :, None, :]
        whole[:, count:, count:] = products.reshape(events, each * paths, -1)
        return np.asarray(np.linalg.inv(whole + np.eye(whole.shape[1])))


def noise_of(
    settings: TwinSettings,
    nuisances: Nuisances,
    station: str,
    blocks: NDArray[np.int64],
    share: Floats,
    slope: Floats,
    jitters: Floats,
    gains: EventGains = BEHIND_EVERYTHING,
) -> Noise:
    """The noise that the twin draws, to first order in its relative size.

    Products of two of its parts (0.3 % of the radiometer's variance) are left out, and lines that were not removed.

    Parameters
    ----------
    blocks
        Averaged blocks, 0 where there is no spectrum, shape (path, event); paths in the order 0 X, 0 Y, 1 X, 1 Y, ...
    share
        Part of the power that comes through the gain in front of N_RCU, shape (path, event, freq).
    slope
        d ln(G_ant A) / d nu, shape (path, freq), per MHz.
    jitters
        1 at events in which the resonance jitters, shape (event,).
    """
    factor = nuisances.noise_factor if station in nuisances.noisy_stations else 1.0
    is_present = blocks > 0
    amplitude = factor * settings.radiometer * np.sqrt(100.0 / np.maximum(blocks, 1).T)
    dipole = np.arange(len(blocks)) % len(DIPOLES)
    between = np.where(dipole[:, None] == dipole, nuisances.sky_correlation, 0.0)
    between[np.diag_indices_from(between)] = 1.0
    rest = _invert_present(between * amplitude[:, :, None] * amplitude[:, None, :], is_present.T)
    in_front, behind = gains.before_receiver(settings), gains.behind(settings)
    everywhere = np.broadcast_to(is_present[:, :, None], share.shape)
    front = everywhere * share
    moved = front * slope[:, None, :] * jitters[:, None]

    def stack(size_in_front: float, size_behind: float, jitter_mhz: float) -> Floats:
        parts = ((size_in_front, front), (factor * size_behind, everywhere), (jitter_mhz, moved))
        kept = [size * part for size, part in parts if size > 0]
        return np.stack(kept) if kept else np.zeros((0, *share.shape))

    common = stack(in_front[0], behind.event_gain_common, gains.common_jitter_mhz)
    return Noise(rest, common, stack(in_front[1], behind.event_gain_path, gains.path_jitter_mhz))


def slope_of_resonance(stages: Stages, frequency_mhz: Floats) -> Floats:
    """Slope d ln(G_ant A) / d nu of every path, shape (antenna x dipole, freq), per MHz."""
    antennas = max(stages.antenna.shape[0], stages.gain.shape[0])
    curves = np.broadcast_to(stages.antenna, (antennas, *stages.antenna.shape[1:]))[:, :, 0]
    slopes = CubicSpline(frequency_mhz, np.log(curves), axis=-1)(frequency_mhz, 1)
    return np.asarray(slopes.reshape(-1, frequency_mhz.size))


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
