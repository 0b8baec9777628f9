"""What the spectra, or another change on record, say against what a person entered: told beside it, never decided.

A person's word is in force whatever drift measures. Where that is something else, or C follows another change in its
place, or a step that drift found lies so near that both may be one, whoever reads the change is to know it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.drift.members import SAME_DATE
from lbacal_core.errors import name_path, write_change
from lbacal_core.grids import YEAR_S
from service.storage.changes import RAMP, STEP, Change, KeptChange, concerns
from service.usecases.calibrations import ByAntenna, find_slow, group_by_antenna
from service.usecases.watch import read_changes

NEAR_US = 30 * DAY_US
"""Steps nearer than this, of which drift finds one alone, may be one: people remember dates to some weeks."""


def find_doubts(
    changes: Sequence[KeptChange], report: Mapping[str, Any], dipoles: Collection[str]
) -> dict[int, tuple[str, ...]]:
    """Find what speaks against changes in force, by their numbers, a clause each.

    Parameters
    ----------
    changes
        All of a station, or of all.
    report
        The newest of drift; empty where there is none.
    """
    found = [one for told in report.get("changes", ()) for one in read_changes(told)]
    of_antenna, doubts = group_by_antenna(changes), dict[int, tuple[str, ...]]()
    for one in changes:
        clauses = list(_find_followed(one, of_antenna, dipoles) if one.slow else ())
        if one.slow and one.is_spoken_of:
            clauses += _compare_slow(one, report)
        elif one.stands and one.is_spoken_of and one.change.kind == STEP:
            clauses += _compare(one.change, found, changes)
        doubts[one.number] = tuple(clauses)
    return doubts


def _find_followed(kept: KeptChange, of_antenna: ByAntenna, dipoles: Collection[str]) -> Iterator[str]:
    """The changes of its kind that C follows in its place, where it follows that in no path."""
    own = kept.change
    paths = [Scope(own.station, a, d) for a, letter in own.paths for d in ([letter] if letter else dipoles)]
    followed = {
        one.number
        for path in paths or [Scope(own.station)]
        for one in find_slow(path, of_antenna)
        if (one.change.kind, one.change.station, not one.change.paths) == (own.kind, own.station, not own.paths)
    }
    if kept.number not in followed:
        yield f"C follows change {' and '.join(map(str, sorted(followed)))} in its place"


def _compare(own: Change, found: Sequence[Change], on_record: Sequence[KeptChange]) -> Iterator[str]:
    """What drift measures of a step that a person entered, or where it finds one instead."""
    same = next((one for one in found if own.is_same(one)), None)
    if same is not None:
        if own.size is not None and same.size is not None:
            sigma = same.size_sigma or 0.0
            if abs(own.size - same.size) > SAME_DATE * math.hypot(own.size_sigma or 0.0, sigma):
                yield f"drift measures {write_change(same.size, sigma)}"
        return
    near = [
        one for one in found
        if one.station == own.station and abs(one.date - own.date) < NEAR_US
        and (set(one.antennas) & set(own.antennas) or one.paths == own.paths)
    ]  # fmt: skip
    for one in sorted(near, key=lambda one: abs(one.date - own.date))[:1]:
        names = [f" (change {other.number})" for other in on_record if other.change.is_same(one)]
        date = f"{format_instant(one.date)[:10]} ± {one.sigma_days:.1f} d"
        yield f"drift finds it on {date}{''.join(names[:1])}, and none here"


def _compare_slow(kept: KeptChange, report: Mapping[str, Any]) -> Iterator[str]:
    """What drift measures of the path that is farthest from a ramp or a season."""
    own, farthest = kept.change, (SAME_DATE, "")
    size, wave = math.log1p(own.size or 0.0), _turn(own.date / SECOND_US / YEAR_S)
    for one in report.get("slopes", ()):
        if (one["station"], one["antenna"] is None) != (own.station, not own.paths) or not (
            concerns(kept, one["antenna"], one["dipole"])
        ):
            continue
        value, sigma, apart = one["slope"], one["sigma"], abs(size - one["slope"])
        words = " a year"
        if own.kind != RAMP:
            value, sigma, phase = one["season"], one["season_sigma"], one["season_phase"]
            apart = abs(size * wave - value * _turn(phase))
            words = f", largest on {format_instant(round(phase * YEAR_S * SECOND_US))[5:10]} (month, day)"
        significance = apart / math.hypot(own.size_sigma or 0.0, sigma)
        if significance > farthest[0]:
            who = name_path(one["station"], one["antenna"], one["dipole"])
            farthest = significance, f"drift measures {write_change(value, sigma)}{words} in {who}"
    if farthest[1]:
        yield farthest[1]


def _turn(years: float) -> complex:
    return cmath.exp(2j * math.pi * years)
