"""Promotion: from now on a version, or none, answers for its scope over an interval."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from lbacal_core.curves import CONVERGED
from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument
from lbacal_core.validity import Instant, Promotion, Scope, Stretch, timeline
from service.errors import ConflictError
from service.storage.database import Database, Stores
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from service.usecases.comparison import CurveChange, compare_curves
from service.wire.bodies import PromotionBody
from service.wire.instants import parse_instant

LAST = 2**63 - 1
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Change:
    """What a promotion changes for a path over [start, end): the version before and after, and how far C moves.

    C is what the path is told, through the cable that it has at `start`.
    """

    path: Scope
    start: Instant
    end: Instant | None
    before: str | None
    after: str | None
    curve_change: CurveChange | None


@dataclass(frozen=True)
class Plan:
    """A promotion that is wanted, and what it changes as long as `newest` is the number of the newest promotion."""

    wanted: Promotion
    changes: list[Change]
    newest: int


@dataclass(frozen=True)
class Promotions:
    """Writes the ledger."""

    database: Database
    instrument: Instrument
    clock: Callable[[], Instant]

    def plan(self, body: PromotionBody, by: str) -> Plan:
        """Work out a promotion and what it would change, while others may promote."""
        with self.database.read() as stores:
            wanted = self._read(stores, body, by)
            return Plan(wanted, self._changes(stores, wanted), stores.ledger.newest_number())

    def promote(self, plan: Plan, describe: Callable[[Promotion, list[Change]], Answer]) -> Answer:
        """Promote, and describe what that changed; what cannot be described is not promoted.

        The changes are worked out again only if somebody else promoted since the plan was made.
        """
        with self.database.write() as stores:
            stores.ledger.lock()
            is_current = stores.ledger.newest_number() == plan.newest
            changes = plan.changes if is_current else self._changes(stores, plan.wanted)
            return describe(stores.ledger.append([plan.wanted], self.clock)[0], changes)

    def _read(self, stores: Stores, body: PromotionBody, by: str) -> Promotion:
        stated = Scope(body.station, body.antenna, body.dipole)
        scope = stated
        if body.calibration is None:
            _require_part_of(self.instrument, scope)
        else:
            version = stores.versions.get(body.calibration)
            scope = version.scope
            if stated not in (Scope(), scope):
                raise BadInputError("body", f"the scope of the version, {scope.key}", stated.key)
            _require_converged(version)
        return Promotion(
            number=0,
            scope=scope,
            valid_from=parse_instant("body.valid_from", body.valid_from),
            valid_to=None if body.valid_to is None else parse_instant("body.valid_to", body.valid_to),
            calibration=body.calibration,
            at=LAST,
            by=by,
            reason=body.reason,
        )

    def _changes(self, stores: Stores, wanted: Promotion) -> list[Change]:
        paths = select_paths(self.instrument, wanted.scope.station, wanted.scope.antenna, wanted.scope.dipole)
        of_scope: dict[Scope, list[Promotion]] = {}
        scopes = {scope for path in paths for scope in path.widening}
        for promotion in stores.ledger.standing(scopes, wanted.valid_from, wanted.valid_to):
            of_scope.setdefault(promotion.scope, []).append(promotion)
        found = []
        for path in paths:
            old = [p for scope in path.widening for p in of_scope.get(scope, [])]
            found += _differences(path, timeline(old, path), timeline([*old, wanted], path))
        ids = {version_id for change in found for version_id in (change.before, change.after) if version_id}
        versions = stores.versions.get_many(ids)
        return [_with_size(change, versions) for change in found]


def _require_part_of(instrument: Instrument, scope: Scope) -> None:
    select_paths(instrument, scope.station, scope.antenna, scope.dipole)


def _require_converged(version: Version) -> None:
    if version.status != CONVERGED:
        raise ConflictError(f"calibration {version.id} cannot be promoted: its status is {version.status}")


def _differences(path: Scope, before: Sequence[Stretch], after: Sequence[Stretch]) -> list[Change]:
    """The stretches over which the version that answers differs."""
    edges = sorted({s.start for s in (*before, *after) if s.start is not None})
    changes: list[Change] = []
    ends = [*edges, None][1:]
    for start, end, old, new in zip(edges, ends, _answers(before, edges), _answers(after, edges), strict=True):
        if old == new:
            continue
        last = changes[-1] if changes else None
        if last is not None and (last.end, last.before, last.after) == (start, old, new):
            changes[-1] = Change(path, last.start, end, old, new, None)
        else:
            changes.append(Change(path, start, end, old, new, None))
    return changes


def _answers(stretches: Sequence[Stretch], instants: Sequence[Instant]) -> list[str | None]:
    """The version that answers at each instant."""
    starts = [stretch.start for stretch in stretches if stretch.start is not None]
    return [stretches[bisect_right(starts, instant)].calibration for instant in instants]


def _with_size(change: Change, versions: dict[str, Version]) -> Change:
    if change.before is None or change.after is None:
        return change
    before, after = (versions[name].tell(change.path, change.start).curve for name in (change.before, change.after))
    size = compare_curves(before, after)
    return Change(change.path, change.start, change.end, change.before, change.after, size)
