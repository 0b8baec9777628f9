"""The life of a path, a station or the array: what was in effect when, and all that happened to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant, Scope, Stretch, timeline
from lbacal_core.instrument.instrument import Instrument
from service.storage.alarms import STATES, Alarm, AlarmsAsked
from service.storage.changes import KeptChange
from service.storage.database import Database
from service.storage.models import Investigation
from service.storage.versions import Version
from service.usecases.alarms import Alarms
from service.usecases.calibrations import select_paths
from service.usecases.changes import Changes, concerns
from service.usecases.models import AdoptedModel, Models

MOST = 1000
"""Versions, alarms and investigations of a life; the newest ones."""


@dataclass(frozen=True)
class Epoch:
    """A time [start, end) in which nothing changed that is in force; `because` is the change that began it."""

    start: Instant | None
    end: Instant | None
    because: int | None


@dataclass(frozen=True)
class Life:
    """All that is known of a scope, each in order of time."""

    scope: Scope
    epochs: Sequence[Epoch]
    in_effect: Sequence[Stretch]
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
        changes = [one for one in self.changes.list_all(station) if concerns(one, antenna, dipole)]
        alarms = self.alarms.newest(AlarmsAsked(STATES, MOST, station=station))
        with self.database.read() as stores:
            stretches = timeline(stores.ledger.standing(scope.widening), scope)
            versions = stores.versions.search(scope, None, "", MOST)
            made = [] if station is None else stores.investigations.newest(before=None, station=station, limit=MOST)
        return Life(
            scope,
            split_epochs(scope, changes),
            [one for one in stretches if one.calibration is not None],
            sorted(versions, key=lambda one: (one.since, one.made)),
            sorted(changes, key=lambda one: one.change.date),
            [one for one in self.models.history() if one.change.station == station][::-1],
            [one for one in alarms if one.news.scope in scope.widening or scope in one.news.scope.widening][::-1],
            list(made)[::-1],
        )


def split_epochs(scope: Scope, changes: Iterable[KeptChange]) -> list[Epoch]:
    """The times between the changes in force at which windows of a path are cut, or which are of a whole station."""
    dates = {
        one.change.date: one.number
        for one in changes
        if one.cuts and (scope.antenna is not None or not one.change.paths)
    }
    edges = sorted(dates)
    starts: list[Instant | None] = [None, *edges]
    return [Epoch(a, b, None if a is None else dates[a]) for a, b in zip(starts, [*edges, None], strict=True)]
