"""What the spectra, or another change on record, say against what a person entered: told beside it, never decided.

A person's word is in force whatever drift measures. Where that is something else, or C follows another change in its
place, or a step that drift found lies so near that both may be one, whoever reads the change is to know it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.calibration.slow_changes import YEAR_S
from lbacal_core.errors import name_path, write_change
from service.storage.changes import RAMP, SAME_DATE, STEP, KeptChange, concerns
from service.usecases.watch import read_changes

NEAR_US = 30 * DAY_US
"""Steps nearer than this, of which drift finds one alone, may be one: people remember dates to some weeks."""


def find_doubts(kept: KeptChange, on_record: Sequence[KeptChange], report: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Find the clauses that speak against a change in force.

    Parameters
    ----------
    on_record
        The changes of its station.
    report
        The newest of drift.
    """
    if not kept.stands:
        return ()
    return (*_find_replaced(kept, on_record), *_compare(kept, on_record, report or {"changes": []}))


def _find_replaced(kept: KeptChange, on_record: Sequence[KeptChange]) -> Iterator[str]:
    """The change of its kind that C follows in its place."""
    own = kept.change
    later = [
        one for one in on_record
        if kept.slow and one.slow and one.rank > kept.rank
        and (one.change.kind, one.change.station, not one.change.paths) == (own.kind, own.station, not own.paths)
        and all({path, (path[0], None)} & set(one.change.paths) for path in own.paths)
    ]  # fmt: skip
    if later:
        yield f"C follows change {max(later, key=lambda one: one.rank).number} in its place"


def _compare(kept: KeptChange, on_record: Sequence[KeptChange], report: Mapping[str, Any]) -> Iterator[str]:
    """What drift measures in place of what a person entered."""
    own = kept.change
    if not kept.is_spoken_of:
        return
    if own.kind != STEP:
        yield from _compare_slow(kept, report)
        return
    found = [one for told in report["changes"] for one in read_changes(told)]
    same = [one for one in found if own.is_same(one)]
    for one in same[:1]:
        apart = None if None in (own.size, one.size) else abs((own.size or 0.0) - (one.size or 0.0))
        if apart is not None and apart > SAME_DATE * math.hypot(own.size_sigma or 0.0, one.size_sigma or 0.0):
            yield f"drift measures {write_change(one.size or 0.0, one.size_sigma or 0.0)}"
    if same:
        return
    near = [
        one for one in found
        if one.station == own.station and abs(one.date - own.date) < NEAR_US
        and (set(one.antennas) & set(own.antennas) or one.paths == own.paths)
    ]  # fmt: skip
    for one in sorted(near, key=lambda one: abs(one.date - own.date))[:1]:
        names = [f" (change {other.number})" for other in on_record if other.change.is_same(one) and other != kept]
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
