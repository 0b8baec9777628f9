"""What was found of an array over time as JSON values: changes, slopes, and the trend of each station and the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from lbacal_core.calibration.years import gain_modes
from lbacal_core.drift.events import MODES
from lbacal_core.drift.follow import Followed, History, Whole, measure_whole
from lbacal_core.drift.members import SAME_DATE
from lbacal_core.drift.search import Found
from lbacal_core.grids import DAY_S, YEAR_S, Floats

# Change points as they are reported: what jumped at one date in one station is one change, however many paths have it.
#
# A cabinet that is repaired, a board of receivers, an antenna with both of its dipoles: their paths step together.
# Steps of a station whose dates agree within their errors are one change with members; the most significant of them
# gives it its date and size. Both dipoles of an antenna are joined first: a small step, whose date is known to months,
# agrees with that of many another antenna by chance.

BY_CHANCE = 10.0
"""So many times likelier than by chance are dates of two antennas that agree, when they are one: most are not."""


@dataclass(frozen=True)
class Member:
    """A path that steps, or with `antenna` None a polarisation of the station; the change of ln C, one entry a mode."""

    antenna: int | None
    dipole: str
    size: tuple[float, ...]
    sigma: tuple[float, ...]
    significance: float


@dataclass(frozen=True)
class Change:
    """A change in a station at a date.

    Attributes
    ----------
    members
        The most significant first.
    date_unix, date_sigma_s
        Median and standard deviation of the date.
    earliest_unix, latest_unix
        The interval that holds 95 % of its probability.
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
    significance: float
    is_known: bool

    @property
    def paths(self) -> set[tuple[int | None, str]]:
        """Antennas and dipoles of the members; one that steps twice has two changes, however near."""
        return {(one.antenna, one.dipole) for one in self.members}


def list_changes(history: History, followed: Followed) -> list[Change]:
    """List the changes of all stations, the most significant first."""
    owners = list(zip(history.station.tolist(), history.antenna.tolist(), history.dipole.tolist(), strict=True))
    steps = list(_steps(followed.paths, owners))
    if followed.stations is not None:
        steps += _steps(followed.stations, [(station, None, dipole) for station, dipole in followed.groups])
    steps.sort(key=lambda step: (-step.significance, step.station, step.date_unix))
    span_s = float(history.time_unix[-1] - history.time_unix[0])
    of_antennas = _join(steps, lambda a, b: a.members[0].antenna == b.members[0].antenna and _may_be_one(a, b))
    return _join(of_antennas, partial(_is_at_one_date, span_s=span_s))


def _join(changes: Sequence[Change], is_one: Callable[[Change, Change], bool]) -> list[Change]:
    """Join each change to the first, more significant one with which it is one."""
    found = list[Change]()
    for change in changes:
        at = next((k for k, one in enumerate(found) if is_one(one, change)), None)
        if at is None:
            found.append(change)
        else:
            found[at] = replace(found[at], members=(*found[at].members, *change.members))
    return found


def _steps(found: Found, owners: Sequence[tuple[str, int | None, str]]) -> Iterator[Change]:
    """Every step of a series, as a change with one member."""
    dates, is_known = found.terms.dates, found.terms.is_known
    for k, j in np.argwhere(np.isfinite(dates)):
        station, antenna, dipole = owners[k]
        date, known, significance = float(dates[k, j]), bool(is_known[k, j]), float(found.step_significance[k, j])
        size, sigma = tuple(found.step_size[k, j].tolist()), tuple(found.step_size_sigma[k, j].tolist())
        yield Change(
            station,
            (Member(antenna, dipole, size, sigma, significance),),
            date,
            0.0 if known else float(found.step_sigma_s[k, j]),
            date if known else float(found.step_earliest[k, j]),
            date if known else float(found.step_latest[k, j]),
            significance,
            known,
        )


def _is_at_one_date(one: Change, other: Change, span_s: float) -> bool:
    """Whether their dates agree far better than those of unrelated changes, which may be anywhere in the span."""
    error = float(np.hypot(_error_of(one, other), DAY_S))
    density = np.exp(-0.5 * ((one.date_unix - other.date_unix) / error) ** 2) / (np.sqrt(2.0 * np.pi) * error)
    return _may_be_one(one, other) and bool(density * span_s >= BY_CHANCE)


def _may_be_one(one: Change, other: Change) -> bool:
    if one.station != other.station or one.is_known != other.is_known or one.paths & other.paths:
        return False
    return abs(one.date_unix - other.date_unix) <= SAME_DATE * _error_of(one, other) + DAY_S


def _error_of(one: Change, other: Change) -> float:
    return float(np.hypot(one.date_sigma_s, other.date_sigma_s))


DIGITS = 7
AGAIN_YEARS = 1.5
"""A season that was not seen again in half a year may as well be a step."""
SILENT_EVENTS = 20
"""So many events of others, eight days of a LOFAR year, without one of a path: it is lost, or sees no sky."""


def describe_followed(history: History, followed: Followed, frequency_mhz: Floats) -> dict[str, Any]:
    """The report of the watch as JSON values, fractions of C and their change a year.

    Keys are `threshold_sigma`, `first_unix`, `last_unix`, `changes`, `slopes`, `trends` (by station and ``array``) and
    `silent`.
    """
    owners = list(zip(history.station.tolist(), history.antenna.tolist(), history.dipole.tolist(), strict=True))
    came_again = bool(np.ptp(history.time_unix) > AGAIN_YEARS * YEAR_S)
    slopes = _slopes(followed.paths, owners, came_again)
    if followed.stations is not None:
        slopes += _slopes(
            followed.stations, [(station, None, dipole) for station, dipole in followed.groups], came_again
        )
    trends = {} if followed.whole is None else {"array": _trend(followed.whole, frequency_mhz)}
    for station in sorted({station for station, _ in followed.groups}):
        rows = [k for k, (name, _) in enumerate(followed.groups) if name == station]
        with np.errstate(invalid="ignore"):
            trend = measure_whole(history.time_unix, followed.paths.median[rows].mean(axis=0))
        if trend is not None:
            trends[station] = _trend(trend, frequency_mhz)
    report = {
        "threshold_sigma": followed.paths.threshold,
        "first_unix": float(history.time_unix[0]),
        "last_unix": float(history.time_unix[-1]),
        "changes": [_change(one) for one in list_changes(history, followed)],
        "slopes": slopes,
        "trends": trends,
        "silent": list(_silent(history)),
    }
    return _drop_noise(report)


def _drop_noise(report: dict[str, Any]) -> dict[str, Any]:
    """The report of a watch without members of changes that are below its threshold, and with every path once.

    Among few antennas the median of a station follows the step of one, and the search finds another one stepping the
    other way. Once the medians are settled, what is left of that is noise.
    """
    threshold = report["threshold_sigma"]
    for change in report["changes"]:
        once = dict[tuple[int | None, str], dict[str, Any]]()
        for one in change["members"]:
            once.setdefault((one["antenna"], one["dipole"]), one)
        change["members"] = list(once.values())
        if not change["is_known"]:
            first, *others = change["members"]
            change["members"] = [first, *(one for one in others if one["significance"] >= threshold)]
    return report


def _silent(history: History) -> Iterator[dict[str, Any]]:
    """Paths that were measured and are no longer, while others of their station are: dead, with or without spectra."""
    is_known = np.isfinite(history.ln_c[..., 0])
    for k in np.flatnonzero(is_known.any(axis=1)):
        of_station = np.flatnonzero(is_known[history.station == history.station[k]].any(axis=0))
        last = int(np.flatnonzero(is_known[k])[-1])
        if np.sum(of_station > last) >= SILENT_EVENTS:
            yield {
                "station": str(history.station[k]), "antenna": int(history.antenna[k]),
                "dipole": str(history.dipole[k]), "last_unix": float(history.time_unix[last]),
            }  # fmt: skip


def _change(change: Change) -> dict[str, Any]:
    return {
        "station": change.station,
        "members": [{"antenna": one.antenna, "dipole": one.dipole, **_sized(one)} for one in change.members],
        "date_unix": change.date_unix,
        "date_sigma_days": change.date_sigma_s / DAY_S,
        "earliest_unix": change.earliest_unix,
        "latest_unix": change.latest_unix,
        **_sized(change.members[0]),
        "is_known": change.is_known,
    }


def _sized(one: Member) -> dict[str, Any]:
    return {
        "size": round(float(np.expm1(one.size[0])), DIGITS),
        "sigma": round(one.sigma[0], DIGITS),
        "shape": _of_modes(one.size[1:], one.sigma[1:]),
        "significance": round(one.significance, 2),
    }


def _of_modes(value: Any, sigma: Any) -> dict[str, dict[str, float]]:
    """Tilt and curvature of ln C, each with its error."""
    return {
        name: {"value": round(float(v), DIGITS), "sigma": round(float(s), DIGITS)}
        for name, v, s in zip(MODES[1:], value, sigma, strict=True)
    }


def _slopes(found: Found, owners: list[tuple[str, int | None, str]], came_again: bool) -> list[dict[str, Any]]:
    """The slope of every series beside its companions, a year, and its season: C is largest at that part of a year."""
    phase = np.arctan2(found.season[:, 1, 0], found.season[:, 0, 0])
    toward = np.stack([np.cos(phase), np.sin(phase)], axis=1)[:, :, None]
    season, sigma = np.sum(found.season * toward, axis=1), np.hypot.reduce(found.season_sigma * toward, axis=1)
    return [
        {
            "station": station,
            "antenna": antenna,
            "dipole": dipole,
            "slope": round(float(found.slope[k, 0]), DIGITS),
            "sigma": round(float(found.slope_sigma[k, 0]), DIGITS),
            "shape": _of_modes(found.slope[k, 1:], found.slope_sigma[k, 1:]),
            "significance": round(float(found.slope_significance[k]), 2),
            "is_found": bool(found.slope_significance[k] > found.threshold),
            "season": round(float(season[k, 0]), DIGITS),
            "season_sigma": round(float(sigma[k, 0]), DIGITS),
            "season_shape": _of_modes(season[k, 1:], sigma[k, 1:]),
            "season_phase": round(float(phase[k] / (2 * np.pi) % 1.0), DIGITS),
            "season_significance": round(float(found.season_significance[k]), 2),
            "season_is_found": came_again and bool(found.season_significance[k] > found.threshold),
        }
        for k, (station, antenna, dipole) in enumerate(owners)
        if found.events[k] > 0
    ]


def _trend(trend: Whole, frequency_mhz: Floats) -> dict[str, Any]:
    """The trend of what many paths share, in frequency too, and what draws it."""
    modes = gain_modes(frequency_mhz)
    return {
        "slope": float(trend.slope[0]),
        "sigma": float(trend.sigma[0]),
        "limit_95": float(trend.limit[0]),
        "scatter": float(trend.scatter[0]),
        "years": trend.years,
        "p_value": trend.p_value,
        "middle_unix": trend.middle_unix,
        "season": [float(value) for value in trend.season[:, 0]],
        "frequency": {
            "mhz": frequency_mhz.tolist(),
            "slope": (trend.slope @ modes).tolist(),
            "sigma": np.sqrt((trend.sigma**2) @ modes**2).tolist(),
        },
    }
