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
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.gains import BEHIND_EVERYTHING, EventGains
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.settings import TwinSettings

EVENTS_TOGETHER = 128
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
        alone = np.einsum("jpef,...pef->...epj", self.own, weighed, optimize=True)
        onto = np.concatenate([alone.reshape(*alone.shape[:-2], -1), together], axis=-1)
        taken = np.einsum("elk,elm,...em->...ek", self._root, self._root, onto, optimize=True)
        count = taken.shape[-1] - len(self.common)
        back = np.einsum("kpef,...ek->...pef", self.common, taken[..., count:], optimize=True)
        back = back + np.einsum("jpef,...epj->...pef", self.own, taken[..., :count].reshape(alone.shape), optimize=True)
        return np.asarray(weighed - np.einsum("epq,...qef->...pef", self.rest, back, optimize=True))

    def projections(
        self, slopes: Floats, constants: Floats, share: Floats, modes: Floats
    ) -> Iterator[tuple[slice, Floats, Floats]]:
        """Projections of the columns of a fit, and of changes of the sky, on the gains: V^-1 = R^-1 - W'W in these.

        Some events at a time, and gains together that show in the same paths: those of the paths of a dipole, then what
        is common to all.

        Parameters
        ----------
        slopes, constants
            As `PathChains.columns`.
        share, modes
            Changes of the sky, shape (mode, dipole, event, freq), of which paths show a share each.

        Returns
        -------
        Which paths, and W in their columns, shape (event x gain, path x column), and in the modes, (..., mode).
        """
        channels = slopes.shape[2]
        for at, paths, shown in self._shown_by_gains():
            columns = np.empty((*shown.shape[:3], channels + len(constants)))
            columns[..., :channels] = shown * slopes[paths, at].transpose(1, 0, 2)[:, None]
            of_constants = shown.transpose(0, 2, 1, 3) @ constants[:, paths, at].transpose(2, 1, 3, 0)
            columns[..., channels:] = of_constants.transpose(0, 2, 1, 3)
            of_modes = np.zeros((*shown.shape[:2], len(modes)))
            if len(modes):
                seen = shown * share[paths, at].transpose(1, 0, 2)[:, None]
                dipoles = np.arange(len(share))[paths] % len(DIPOLES)
                for d in np.unique(dipoles):
                    of_modes += seen[:, :, dipoles == d].sum(axis=2) @ modes[:, d, at].transpose(1, 2, 0)
            rows = shown.shape[0] * shown.shape[1]
            yield paths, columns.reshape(rows, -1), of_modes.reshape(rows, len(modes))

    def _shown_by_gains(self) -> Iterator[tuple[slice, slice, Floats]]:
        """W event by event without columns, as `projections` has it: events, paths, shape (event, gain, path, freq)."""
        each, paths, events, channels = self.own.shape
        gain_of_path = np.arange(paths * each).reshape(paths, each)
        count = paths * each
        for begin in range(0, events, EVENTS_TOGETHER):
            at = slice(begin, min(begin + EVENTS_TOGETHER, events))
            rest, root = self.rest[at], self._root[at]
            together = np.einsum("epq,kqef->ekpf", rest, self.common[:, :, at], optimize=True)
            of_all = root[:, count:, count:] @ together.reshape(*together.shape[:2], paths * channels)
            of_all = of_all.reshape(together.shape)
            for d in range(len(DIPOLES)):
                own, of_own = slice(d, None, len(DIPOLES)), gain_of_path[d :: len(DIPOLES)].ravel()
                alone = np.einsum("eqp,jpef->epjqf", rest[:, own, own], self.own[:, own, at], optimize=True)
                shape = (len(rest), of_own.size, *alone.shape[3:])
                alone = alone.reshape(*shape[:2], shape[2] * channels)
                of_all[:, :, own] += (root[:, count:, of_own] @ alone).reshape(len(rest), len(self.common), *shape[2:])
                if of_own.size:
                    yield at, own, (root[:, of_own[:, None], of_own] @ alone).reshape(shape)
            if len(self.common):
                yield at, slice(None), of_all

    @cached_property
    def _root(self) -> Floats:
        """Inverse of the lower Cholesky factor of 1 + U' R^-1 U, shape (event, gain, gain).

        The gains of each path come first, path by path: those of one dipole's paths do not show in the other's.
        """
        count, each, paths = len(self.common), len(self.own), self.rest.shape[1]
        events, alone = len(self.rest), each * paths
        weighed = np.einsum("epq,kqef->kpef", self.rest, self.common, optimize=True)
        whole = np.empty((events, alone + count, alone + count))
        whole[:, alone:, alone:] = np.einsum("kpef,lpef->ekl", self.common, weighed, optimize=True)
        mixed = np.einsum("jpef,kpef->epjk", self.own, weighed, optimize=True).reshape(events, alone, count)
        whole[:, :alone, alone:], whole[:, alone:, :alone] = mixed, mixed.transpose(0, 2, 1)
        products = np.einsum("jpef,iqef->epjqi", self.own, self.own, optimize=True)
        products *= self.rest[:, :, None, :, None]
        whole[:, :alone, :alone] = products.reshape(events, alone, alone)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(whole + np.eye(alone + count))))


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
