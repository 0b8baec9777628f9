"""Whom a cause concerns: the paths of a station that share an effect, and the vectors it makes in the whitened data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.terms import ChainTerms
from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.whitening import Residuals
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class Target:
    """A set of paths: one path, an antenna, a cable name, or the station.

    Attributes
    ----------
    scope
        One of `lbacal_core.causes.terms.SCOPES`.
    label
        In words: ``antenna 17 X``, ``antenna 17``, ``cable 80``, ``station``.
    is_member
        Shape (path,).
    """

    scope: str
    label: str
    is_member: NDArray[np.bool_]


def list_targets(data: StationData) -> list[Target]:
    """Every path, antenna and cable name of a station, and the station; sets that coincide are named once."""
    paths = len(data.antenna)
    targets = []
    if paths > len(np.unique(data.dipole)):
        targets += [
            Target("path", f"antenna {data.antenna[k]} {data.dipole[k]}", np.arange(paths) == k) for k in range(paths)
        ]
        for antenna in np.unique(data.antenna):
            is_member = data.antenna == antenna
            if is_member.sum() > 1:
                targets.append(Target("antenna", f"antenna {antenna}", is_member))
    cables = np.array(data.conditions.cables)[data.class_of]
    names = np.unique(cables)
    if len(names) > 1:
        targets += [
            Target("cable", f"cable {name}", cables == name) for name in names if (cables == name).sum() < paths
        ]
    return [*targets, Target("station", "station", np.ones(paths, dtype=bool))]


@dataclass(frozen=True)
class Nuisance:
    """Orthonormal bases of what the fit absorbs: of the station's mean, and of a path of each class."""

    mean: Floats
    path: list[Floats]

    def dual_mean(self, residuals: Residuals) -> Floats:
        """The basis pulled back, shape (rank, dipole, event, freq): its product with a signature is absorbed."""
        return residuals.pull_back_mean(self.mean.T)

    def dual_path(self, residuals: Residuals, index: int) -> Floats:
        """The basis of a class pulled back, shape (rank, event, freq)."""
        return residuals.pull_back_path(self.path[index].T)

    def clean_mean(self, whitened: Floats) -> Floats:
        """Whitened station-wide vectors less what the fit absorbs, shape (..., n)."""
        return np.asarray(whitened - (whitened @ self.mean) @ self.mean.T)

    def clean_path(self, whitened: Floats, index: int) -> Floats:
        """Whitened vectors of a path of a class less what the fit absorbs, shape (..., n)."""
        basis = self.path[index]
        return np.asarray(whitened - (whitened @ basis) @ basis.T)


def find_nuisance(data: StationData, residuals: Residuals, terms: ChainTerms, modes: Floats | None) -> Nuisance:
    """What the fit absorbs: each channel's A(nu), and the three noise constants.

    Parameters
    ----------
    modes
        Relative changes of P_sky by which sky and antenna models differ, shape (mode, class, event, freq), or None.
    """
    channels = data.power.shape[2]
    power = terms.power()
    front = np.broadcast_to((terms.sky + terms.n_lna) * terms.front / power, power.shape)
    constants = [
        np.broadcast_to(column, power.shape)
        for column in (terms.front / power, data.conditions.receiver_gain / power, 1.0 / power)
    ]
    per_path, columns = [], []
    for index in range(power.shape[0]):
        own = np.zeros((channels, *power.shape[1:]))
        own[np.arange(channels), :, np.arange(channels)] = front[index].T
        block = np.concatenate([own, np.stack([column[index] for column in constants])])
        columns.append(block)
        per_path.append(_orthonormal(residuals.whiten_path(block)))
    rows = []
    for place, letter in enumerate(residuals.letters):
        members = data.class_of[data.dipole == letter]
        share = np.bincount(members, minlength=power.shape[0]) / members.size
        block = np.zeros((channels + 3, len(residuals.letters), *power.shape[1:]))
        block[:, place] = np.einsum("c,ckef->kef", share, np.stack(columns))
        rows.append(residuals.whiten_mean(block))
    if modes is not None and modes.size:
        sky_share = terms.sky * terms.front / power
        rows.append(residuals.whiten_mean(mean_over_paths(data, residuals, modes * sky_share)))
    return Nuisance(_orthonormal(np.concatenate(rows)), per_path)


def mean_over_paths(
    data: StationData, residuals: Residuals, signatures: Floats, is_member: NDArray[np.bool_] | None = None
) -> Floats:
    """What the mean over paths shows of an effect: (..., class, event, freq) -> (..., dipole, event, freq).

    Paths that are not concerned count as zero.
    """
    classes = signatures.shape[-3]
    shares = np.zeros((len(residuals.letters), classes))
    for place, letter in enumerate(residuals.letters):
        of_letter = data.dipole == letter
        concerned = of_letter if is_member is None else of_letter & is_member
        shares[place] = np.bincount(data.class_of[concerned], minlength=classes) / of_letter.sum()
    return np.asarray(np.einsum("dc,...cef->...def", shares.astype(signatures.dtype), signatures))


def _orthonormal(rows: Floats) -> Floats:
    """Orthonormal basis of the span of rows, shape (n, rank); columns of any size count alike."""
    scaled = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = values > 1e-10 * values[-1]
    return np.asarray((scaled.T @ vectors[:, kept]) / np.sqrt(values[kept]))
