"""The life of a path, a station or the array: what was in effect when, and all that happened to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lbacal_core.curves.validity import Scope, Stretch, timeline
from lbacal_core.instrument.instrument import Instrument
from service.storage.alarms import STATES, Alarm, AlarmsAsked
from service.storage.changes import Epoch, KeptChange, concerns, split_epochs
from service.storage.database import Database
from service.storage.models import Investigation
from service.storage.versions import Version
from service.usecases.alarms import Alarms
from service.usecases.calibrations import select_paths
from service.usecases.changes import Changes
from service.usecases.models import AdoptedModel, Models

MOST = 1000
"""Versions, alarms and investigations of a life; the newest ones."""


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
            stretches = [
                one for one in timeline(stores.ledger.standing(scope.widening), scope) if one.calibration is not None
            ]
            versions = stores.versions.newest(scope, (str(one.calibration) for one in stretches))
            made = [] if station is None else stores.investigations.newest(before=None, station=station, limit=MOST)
        return Life(
            scope,
            split_epochs(scope, changes),
            stretches,
            versions,
            sorted(changes, key=lambda one: one.change.date),
            [one for one in self.models.history() if one.change.station == station][::-1],
            [one for one in alarms if one.news.scope in scope.widening or scope in one.news.scope.widening][::-1],
            list(made)[::-1],
        )
