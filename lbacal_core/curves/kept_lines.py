"""What is kept of a fit so that later events can continue it, without the spectra behind it."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

HEAD = "head"
Owner = tuple[str | None, int | None, str]
"""Station, antenna and dipole; station and antenna are None where it is a mean."""


@dataclass(frozen=True)
class MemberLines:
    """The lines of the paths that a mean was taken of.

    Attributes
    ----------
    stations, antennas
        Who they are, shape (member,).
    slope, intercept
        s and b, shape (member, freq).
    level
        Mean power over events and channels, with which a member counts in an event, shape (member,); 0 of one that is
        away, of which the mean has the lines alone.
    scatter
        Standard deviation of the band power of an event, relative, shape (member,).
    """

    stations: NDArray[np.str_]
    antennas: NDArray[np.int64]
    slope: Floats
    intercept: Floats
    level: Floats
    scatter: Floats

    @property
    def names(self) -> list[tuple[str, int]]:
        """Station and antenna of each."""
        return list(zip(self.stations.tolist(), self.antennas.tolist(), strict=True))

    def select(self, names: Container[tuple[str, int]]) -> MemberLines:
        """Select the members among some stations and antennas."""
        return self.take(np.array([name in names for name in self.names], dtype=bool))

    @property
    def is_away(self) -> NDArray[np.bool_]:
        """Whether a member takes part in no event, shape (member,)."""
        return np.asarray(self.level == 0.0)

    @property
    def present(self) -> set[tuple[str, int]]:
        """Station and antenna of each that takes part in events."""
        return set(self.take(~self.is_away).names)

    def variance_of(self, names: Container[tuple[str, int]]) -> float:
        """The relative variance of the mean of some members in an event, as far as they scatter independently."""
        some = self.select(names)
        return float(np.sum((some.level * some.scatter) ** 2) / np.sum(some.level) ** 2)

    def take(self, at: NDArray[np.bool_]) -> MemberLines:
        """Take the members of a mask, shape (member,)."""
        return MemberLines(**{key: values[at] for key, values in vars(self).items()})


def join_members(parts: Sequence[MemberLines]) -> MemberLines:
    """The members of several parts, in their order."""
    return MemberLines(**{f.name: np.concatenate([getattr(one, f.name) for one in parts]) for f in fields(MemberLines)})


def join_away(here: MemberLines, elsewhere: Sequence[MemberLines]) -> MemberLines:
    """The members of a mean with those that are away, whose lines other windows have.

    The mean of a station would otherwise be that of other antennas while one is dead, and differ by its departure. The
    lines of who is away are those of then, times what the members of both windows gained since.

    Parameters
    ----------
    elsewhere
        The members in other windows that have the same hardware in all, the nearest first.
    """
    for there in elsewhere:
        own, then = here.names, {name: k for k, name in enumerate(there.names) if not there.is_away[k]}
        both = [k for k, name in enumerate(own) if name in then and not here.is_away[k]]
        at = [k for name, k in then.items() if name not in own]
        if both and at:
            of = [then[own[k]] for k in both]
            slope, intercept = (
                one[at] * now[both].sum(axis=0) / one[of].sum(axis=0)
                for one, now in ((there.slope, here.slope), (there.intercept, here.intercept))
            )
            none = np.zeros(len(at))
            away = MemberLines(there.stations[at], there.antennas[at], slope, intercept, none, there.scatter[at])
            here = join_members([here, away])
    return here


@dataclass(frozen=True)
class KeptLines:
    """The lines of some paths of one polarisation, or of a mean as one path, with all that more events need.

    Attributes
    ----------
    owners
        Station, antenna and dipole of each path; station and antenna are None where it is a mean.
    events
        How many events each was fitted to, shape (path,).
    has_c
        Whether the fit gave a curve, shape (path,).
    is_good
        Whether the curve is no misfit, so that other windows may use the lines, shape (path,).
    slope, intercept
        s and b, shape (path, freq).
    information
        Inverse covariance of (s, b), shape (path, 2 freq, 2 freq).
    radiometer, constant, behind
        The noise of an event, as in `calibration.lines`: shape (path, freq), (path, vector, freq) twice.
    scatter
        Standard deviation of the band power of an event, relative, shape (path,).
    loss
        L_coax of each path, of a mean the mean over its members, shape (path, freq).
    spectra
        Hash of the spectra of each path, and of what it has of other windows.
    typical_blocks, variance_unit
        The number of blocks, and the relative variance, of the spectrum that the radiometer noise is that of.
    members
        The paths of a mean; None where the paths are single ones.
    form
        The form of the chain that was fitted to them.
    """

    owners: Sequence[Owner]
    events: NDArray[np.int64]
    has_c: NDArray[np.bool_]
    is_good: NDArray[np.bool_]
    slope: Floats
    intercept: Floats
    information: Floats
    radiometer: Floats
    constant: Floats
    behind: Floats
    scatter: Floats
    loss: Floats
    spectra: NDArray[np.str_]
    typical_blocks: float
    variance_unit: float = 1.0
    members: MemberLines | None = None
    form: str = "published"

    def lend(self, good: Container[Owner]) -> KeptLines:
        """The same, where other windows may use the lines of these owners and of no others."""
        return replace(self, is_good=np.array([owner in good for owner in self.owners]))


def write_lines(kept: Sequence[KeptLines]) -> dict[str, Any]:
    """Write lines as arrays by name; of the information matrices one half, in single precision."""
    head, arrays = [], dict[str, Any]()
    for k, one in enumerate(kept):
        upper = np.triu_indices(one.information.shape[1])
        half = one.information[:, upper[0], upper[1]].astype(np.float32)
        head.append(
            [list(map(list, one.owners)), one.typical_blocks, one.variance_unit, one.members is not None, one.form]
        )
        arrays |= {f"{k}.{name}": getattr(one, name) for name in _ARRAYS} | {f"{k}.information": half}
        if one.members is not None:
            arrays |= {f"{k}.member_{name}": values for name, values in vars(one.members).items()}
    return {HEAD: np.array(json.dumps(head)), **arrays}


def read_lines(arrays: Mapping[str, Any]) -> list[KeptLines]:
    """Read what `write_lines` wrote."""
    return [
        KeptLines(
            owners=[(station, antenna, dipole) for station, antenna, dipole in owners],
            typical_blocks=blocks,
            variance_unit=unit,
            members=MemberLines(**{f.name: arrays[f"{k}.member_{f.name}"] for f in fields(MemberLines)})
            if is_mean
            else None,
            form=form,
            **{name: arrays[f"{k}.{name}"] for name in _ARRAYS},
            information=_whole(arrays[f"{k}.information"], 2 * arrays[f"{k}.slope"].shape[1]),
        )
        for k, (owners, blocks, unit, is_mean, form) in enumerate(json.loads(str(arrays[HEAD])))
    ]


_ARRAYS = (
    "events", "has_c", "is_good", "slope", "intercept", "radiometer", "constant", "behind", "scatter", "loss",
    "spectra",
)  # fmt: skip


def _whole(half: Any, size: int) -> Floats:
    """Symmetric matrices from their upper halves."""
    upper = np.triu_indices(size)
    found = np.empty((len(half), size, size))
    found[:, upper[0], upper[1]] = half
    found[:, upper[1], upper[0]] = half
    return found
