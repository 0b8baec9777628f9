"""Promotion: from now on a version, or none, answers for its scope over an interval."""

from __future__ import annotations

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
class Promotions:
    """Writes the ledger."""

    database: Database
    instrument: Instrument
    clock: Callable[[], Instant]

    def preview(self, body: PromotionBody, by: str) -> list[Change]:
        """What a promotion would change."""
        with self.database.read() as stores:
            return self._changes(stores, self._plan(stores, body, by))

    def promote(self, body: PromotionBody, by: str, describe: Callable[[Promotion, list[Change]], Answer]) -> Answer:
        """Promote, and describe what that changed; what cannot be described is not promoted."""
        with self.database.write() as stores:
            wanted = self._plan(stores, body, by)
            stores.ledger.lock()
            changes = self._changes(stores, wanted)
            return describe(stores.ledger.append([wanted], self.clock)[0], changes)

    def _plan(self, stores: Stores, body: PromotionBody, by: str) -> Promotion:
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
        for promotion in stores.ledger.of_scopes(scope for path in paths for scope in path.widening):
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
    for start, end in zip(edges, [*edges, None][1:], strict=True):
        old, new = _at(before, start), _at(after, start)
        if old == new:
            continue
        last = changes[-1] if changes else None
        if last is not None and (last.end, last.before, last.after) == (start, old, new):
            changes[-1] = Change(path, last.start, end, old, new, None)
        else:
            changes.append(Change(path, start, end, old, new, None))
    return changes


def _at(stretches: Sequence[Stretch], instant: Instant) -> str | None:
    return next(s.calibration for s in reversed(stretches) if s.start is None or s.start <= instant)


def _with_size(change: Change, versions: dict[str, Version]) -> Change:
    if change.before is None or change.after is None:
        return change
    before, after = (versions[name].tell(change.path, change.start).curve for name in (change.before, change.after))
    size = compare_curves(before, after)
    return Change(change.path, change.start, change.end, change.before, change.after, size)
