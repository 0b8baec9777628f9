"""The life of a path, a station or the array: all that happened to it; and the paths not to be used at an instant."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lbacal.instants import SECOND_US, format_instant
from lbacal_core.calibration.spreads import serve_reference
from lbacal_core.curves.reference_chain import CableTable
from lbacal_core.curves.validity import Instant, Promotion, Scope, Stretch, timeline
from lbacal_core.instrument.instrument import Instrument
from service.storage.alarms import LOST_PATH, STATES, Alarm, AlarmsAsked, News
from service.storage.changes import LARGEST_TAKEN_OUT, STEP, Epoch, KeptChange, concerns, split_epochs
from service.storage.database import Database
from service.storage.ledger import pick_answering
from service.storage.models import Investigation
from service.storage.sums import DRIFT, Sums
from service.storage.versions import Version
from service.usecases.alarms import Alarms
from service.usecases.calibrations import ByAntenna, find_slow, follow_through, group_by_antenna, select_paths
from service.usecases.changes import Changes
from service.usecases.drift import is_of_step
from service.usecases.models import AdoptedModel, Models
from service.usecases.watch import YEAR_US, assemble_history

MOST = 1000
"""Versions, alarms and investigations that are looked at; the newest ones."""


class Factor(NamedTuple):
    """C that follows ramps and seasons at an instant over C of its version, mean over the band, and its error."""

    at: Instant
    value: float
    sigma: float


@dataclass(frozen=True)
class Life:
    """All that is known of a scope, each in order of time.

    `factors` are those of each stretch in effect, every 30 days; None where C stands still.
    """

    scope: Scope
    epochs: Sequence[Epoch]
    in_effect: Sequence[Stretch]
    factors: Sequence[Sequence[Factor] | None]
    withdrawals: Sequence[Promotion]
    versions: Sequence[Version]
    changes: Sequence[KeptChange]
    causes: Sequence[AdoptedModel]
    alarms: Sequence[Alarm]
    investigations: Sequence[Investigation]


@dataclass(frozen=True)
class Lives:
    """Puts lives together."""

    database: Database
    instrument: Instrument
    changes: Changes
    models: Models
    alarms: Alarms

    def of(self, station: str | None, antenna: int | None = None, dipole: str | None = None) -> Life:
        """The life of a path, of a station, or of the array."""
        select_paths(self.instrument, station, antenna, dipole)
        scope = Scope(station, antenna, dipole)
        changes = [
            # epochs are alike for both dipoles
            one for one in self.changes.list_doubted(station)
            if concerns(one, antenna, None if one.bounds_epoch else dipole)
        ]  # fmt: skip
        alarms = self.alarms.newest(AlarmsAsked(STATES, MOST, station=station))
        with self.database.read() as stores:
            stretches = [
                one for one in timeline(stores.ledger.standing(scope.widening), scope) if one.calibration is not None
            ]
            withdrawals = stores.ledger.withdrawn(scope.widening)
            names = [str(one.calibration) for one in stretches]
            versions, answering = stores.versions.newest(scope, names), stores.versions.get_many(names)
            made = [] if station is None else stores.investigations.newest(before=None, station=station, limit=MOST)
        of_antenna = group_by_antenna(changes)
        return Life(
            scope,
            split_epochs(scope, changes, CableTable.of(self.instrument).records.get(scope.parts[:2], ())),
            stretches,
            [_follow(one, answering[str(one.calibration)], of_antenna) for one in stretches],
            withdrawals,
            versions,
            sorted(changes, key=lambda one: one.change.date),
            [] if station is None else self.models.history(station)[::-1],
            [one for one in alarms if _is_of(scope, one.news)][::-1],
            list(made)[::-1],
        )


def _is_of(scope: Scope, news: News) -> bool:
    """Whether an alarm is of a scope, of what it is a part of, or of a part of it; that of a step names its paths."""
    if "members" in news.content:
        return is_of_step(scope, news.content)
    is_named = scope.antenna is None or scope.key in news.content.get("paths", [scope.key])
    return is_named and (news.scope in scope.widening or scope in news.scope.widening)


def _follow(stretch: Stretch, version: Version, of_antenna: ByAntenna) -> list[Factor] | None:
    """C along slow changes, every 30 days of a stretch."""
    slow, served = find_slow(version.scope, of_antenna), serve_reference(version.curves[0])
    followed = follow_through(stretch, served, version, slow) if slow else []
    return [Factor(at, float(one.factor.mean()), one.error) for at, one in followed] or None


# Paths not to be used at an instant: silent ones, those that hardly hear the sky, and those that lost half.


@dataclass(frozen=True)
class BadPath:
    """A path, and why it is not to be used.

    Attributes
    ----------
    kind
        ``silent``: no usable spectrum from then on until after the instant, while others have many; ``insensitive``:
        left out of an investigation, as it does not work or hardly hears the sky; ``weak``: its power fell by more than
        half at a change that is in force.
    source
        Where that stands: a path of the API.
    """

    path: Scope
    kind: str
    since: Instant
    sentence: str
    source: str


def list_bad(
    database: Database, instrument: Instrument, instant: Instant, station: str | None
) -> tuple[list[BadPath], int]:
    """The bad paths on record of a station, or of all, in order of path, a row a reason; and how many have C then."""
    on_record = {(one.station, one.antenna) for one in instrument.antennas if one.covers(instant / SECOND_US)}
    paths = [path for path in select_paths(instrument, station, None, None) if path.parts[:2] in on_record]
    with database.read() as stores:
        alarms = stores.alarms.newest(AlarmsAsked(STATES, MOST, kind=LOST_PATH, station=station), instant)
        years = [one for one in stores.sums.during(DRIFT, instant - YEAR_US, instant + YEAR_US) if one.arrays]
        made = stores.investigations.newest_covering(instant, station)
        changes, answers = stores.changes.kept(station), stores.ledger.answers(paths, instant, None)
    silent, measured = _find_silent(years, instant) if years else ([], set())
    silent += [one for one in _read_silent(alarms, paths, instant) if one.path not in measured]
    found = [*silent, *_insensitive(made), *_weak(changes, paths, instant)]
    order = {path: number for number, path in enumerate(paths)}
    bad = sorted((one for one in found if one.path in order), key=lambda one: (order[one.path], one.kind))
    return bad, len(pick_answering(answers))


def _find_silent(years: Sequence[Sums], instant: Instant) -> tuple[list[BadPath], set[Scope]]:
    """Find the paths that were not measured about an instant while others were, and all that were before it.

    The dates of the data count, whenever these came.
    """
    from lbacal_core.drift.report import SILENT_EVENTS

    history, silent, measured = assemble_history(years, {}), list[BadPath](), set[Scope]()
    time_us = np.round(history.time_unix * SECOND_US).astype(np.int64).tolist()
    now = bisect_right(time_us, instant)
    owners = zip(history.station.tolist(), history.antenna.tolist(), history.dipole.tolist(), strict=True)
    for owner, is_known in zip(owners, np.isfinite(history.ln_c[..., 0]), strict=True):
        path, before, later = Scope(*owner), np.flatnonzero(is_known[:now]), np.flatnonzero(is_known[now:])
        if not before.size:
            continue
        measured.add(path)
        last, following = int(before[-1]), now + int(later[0]) if later.size else len(time_us)
        if following - last > SILENT_EVENTS:
            sentence = f"no spectrum that sees the sky since {format_instant(time_us[last])[:10]}"
            sentence += f" until {format_instant(time_us[following])[:10]}" if later.size else ""
            silent.append(BadPath(path, "silent", time_us[last], sentence, f"/v1/paths/{path.key}/life"))
    return silent, measured


def _read_silent(alarms: Sequence[Alarm], paths: Sequence[Scope], instant: Instant) -> Iterator[BadPath]:
    """The paths that alarms name."""
    by_key = {path.key: path for path in paths}
    for one in alarms:
        since = one.news.since
        if since is None or since > instant or (one.ended is not None and one.ended <= instant):
            continue
        sentence = f"no spectrum that sees the sky since {format_instant(since)[:10]}"
        for path in (by_key[key] for key in one.news.content.get("paths", []) if key in by_key):
            yield BadPath(path, "silent", since, sentence, f"/v1/alarms/{one.number}")


def _insensitive(made: Sequence[Investigation]) -> Iterator[BadPath]:
    for one in made:
        when = f"{format_instant(one.since)[:10]} to {format_instant(one.until)[:10]}"
        sentence = f"left out of the investigation of {when}: it does not work, or hardly hears the sky"
        for label in (label for station in one.report["stations"] for label in station.get("deaf", [])):
            _, antenna, dipole = label.split()
            path = Scope(one.station, int(antenna), dipole)
            yield BadPath(path, "insensitive", one.since, sentence, f"/v1/investigations/{one.id}")


def _weak(changes: Sequence[KeptChange], paths: Sequence[Scope], instant: Instant) -> Iterator[BadPath]:
    """Paths whose last step before the instant took more than half of their power."""
    steps = [one for one in changes if one.stands and one.change.kind == STEP and one.change.date <= instant]
    steps.sort(key=lambda one: one.change.date)
    for path in paths:
        own = [one for one in steps if one.change.station == path.station and concerns(one, path.antenna, path.dipole)]
        size = own[-1].change.of(path.antenna, path.dipole).size if own else None
        if size is not None and 2.0 * math.log1p(size) > LARGEST_TAKEN_OUT:  # C^2 is proportional to 1 / power
            date = own[-1].change.date
            sentence = f"its power fell to {(1.0 + size) ** -2.0:.0%} on {format_instant(date)[:10]}"
            yield BadPath(path, "weak", date, sentence, f"/v1/changes#{own[-1].number}")
