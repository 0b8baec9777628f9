"""Change points as they are reported: what jumped at one date in one station is one change, however many paths have it.

A cabinet that is repaired, a board of receivers, an antenna with both of its dipoles: their paths step together. Steps
of a station whose dates agree within their errors are one change with members; the most significant of them gives it
its date and size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.drift.follow import Followed, History
from lbacal_core.drift.search import Found

SAME_DATE = 3.0
"""Standard deviations of the difference of two dates within which they are one."""
ONE_DAY_S = 86_400.0


@dataclass(frozen=True)
class Member:
    """A path that steps, or with `antenna` None a polarisation of the station; size is the change of ln C."""

    antenna: int | None
    dipole: str
    size: float
    sigma: float
    significance: float


@dataclass(frozen=True)
class Change:
    """What changed in a station at a date.

    Attributes
    ----------
    members
        The most significant first.
    date_unix, date_sigma_s
        Median and standard deviation of the date.
    earliest_unix, latest_unix
        The interval that holds 95 % of its probability.
    size, size_sigma
        Those of the most significant member, one entry a mode: gain, tilt, curvature of ln C.
    significance
        Standard deviations, corrected for nothing: `Followed` says from which on something is found.
    is_known
        Whether the hardware of every member changed then, as the instrument says.
    """

    station: str
    members: tuple[Member, ...]
    date_unix: float
    date_sigma_s: float
    earliest_unix: float
    latest_unix: float
    size: tuple[float, ...]
    size_sigma: tuple[float, ...]
    significance: float
    is_known: bool


@dataclass(frozen=True)
class _Step:
    """A step of one series."""

    station: str
    antenna: int | None
    dipole: str
    date: float
    sigma: float
    earliest: float
    latest: float
    size: tuple[float, ...]
    size_sigma: tuple[float, ...]
    significance: float
    is_known: bool


def list_changes(history: History, followed: Followed) -> list[Change]:
    """List the changes of all stations, the most significant first."""
    owners = list(zip(history.station.tolist(), history.antenna.tolist(), history.dipole.tolist(), strict=True))
    steps = list(_steps(followed.paths, owners))
    if followed.stations is not None:
        steps += _steps(followed.stations, [(station, None, dipole) for station, dipole in followed.groups])
    steps.sort(key=lambda step: (-step.significance, step.station, step.date))
    gathered: list[list[_Step]] = []
    for step in steps:
        same = next((one for one in gathered if _is_same_date(one[0], step)), None)
        if same is None:
            gathered.append([step])
        else:
            same.append(step)
    return [_merge(one) for one in gathered]


def _steps(found: Found, owners: Sequence[tuple[str, int | None, str]]) -> Iterator[_Step]:
    dates, is_known = found.terms.dates, found.terms.is_known
    for k, j in np.argwhere(np.isfinite(dates)):
        station, antenna, dipole = owners[k]
        date = float(dates[k, j])
        known = bool(is_known[k, j])
        yield _Step(
            station,
            antenna,
            dipole,
            date,
            0.0 if known else float(found.step_sigma_s[k, j]),
            date if known else float(found.step_earliest[k, j]),
            date if known else float(found.step_latest[k, j]),
            tuple(found.step_size[k, j].tolist()),
            tuple(found.step_size_sigma[k, j].tolist()),
            float(found.step_significance[k, j]),
            known,
        )


def _is_same_date(one: _Step, other: _Step) -> bool:
    if one.station != other.station or one.is_known != other.is_known:
        return False
    return abs(one.date - other.date) <= SAME_DATE * float(np.hypot(one.sigma, other.sigma)) + ONE_DAY_S


def _merge(steps: Sequence[_Step]) -> Change:
    first = steps[0]
    members = tuple(Member(s.antenna, s.dipole, s.size[0], s.size_sigma[0], s.significance) for s in steps)
    return Change(
        first.station, members, first.date, first.sigma, first.earliest, first.latest, first.size, first.size_sigma,
        first.significance, all(step.is_known for step in steps),
    )  # fmt: skip
