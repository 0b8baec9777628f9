"""The life of a path, a station or the array: what was in effect when, and all that happened to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lbacal.instants import DAY_US
from lbacal_core.calibration.spreads import tell_reference
from lbacal_core.curves.validity import Instant, Scope, Stretch, timeline
from lbacal_core.instrument.instrument import Instrument
from service.storage.alarms import STATES, Alarm, AlarmsAsked
from service.storage.changes import Epoch, KeptChange, concerns, split_epochs
from service.storage.database import Database
from service.storage.models import Investigation
from service.storage.versions import Version
from service.usecases.alarms import Alarms
from service.usecases.calibrations import ByAntenna, find_slow, follow, group_by_antenna, select_paths
from service.usecases.changes import Changes
from service.usecases.models import AdoptedModel, Models

MOST = 1000
"""Versions, alarms and investigations of a life; the newest ones."""
SAMPLED_US = 30 * DAY_US


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
            names = [str(one.calibration) for one in stretches]
            versions, answering = stores.versions.newest(scope, names), stores.versions.get_many(names)
            made = [] if station is None else stores.investigations.newest(before=None, station=station, limit=MOST)
        of_antenna = group_by_antenna(changes)
        return Life(
            scope,
            split_epochs(scope, changes),
            stretches,
            [_follow(one, answering[str(one.calibration)], of_antenna) for one in stretches],
            versions,
            sorted(changes, key=lambda one: one.change.date),
            [] if station is None else self.models.history(station)[::-1],
            [one for one in alarms if one.news.scope in scope.widening or scope in one.news.scope.widening][::-1],
            list(made)[::-1],
        )


def _follow(stretch: Stretch, version: Version, of_antenna: ByAntenna) -> list[Factor] | None:
    """C along slow changes, every 30 days of a stretch."""
    slow, told = find_slow(version.scope, of_antenna), tell_reference(version.curves[0])
    since, until = stretch.start or version.since, stretch.end or version.until
    followed = [(at, follow(told, version, slow, at)) for at in range(since, until, SAMPLED_US)] if slow else []
    return [Factor(at, float(one.factor.mean()), one.error) for at, one in followed] or None
