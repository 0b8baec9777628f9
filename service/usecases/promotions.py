"""Promotion: from now on a version, or none, answers for its scope over an interval."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from lbacal.instants import format_instant, parse_instant
from lbacal_core.curves.curves import CONVERGED
from lbacal_core.curves.validity import Instant, Promotion, Scope, Stretch, list_deciding, timeline
from lbacal_core.errors import BadInputError, offer_name
from lbacal_core.instrument.instrument import Instrument
from service.errors import ConflictError, NotFoundError
from service.storage.database import Database, Stores
from service.storage.jobs import OPEN
from service.storage.ledger import Tag
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from service.usecases.gate import CurveChange, compare_curves
from service.wire.bodies import PromotionBody, ReasonBody, TagBody

LAST = 2**63 - 1
OFFERED = 1000
"""Tags of which the one that may be meant is named."""
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Change:
    """The change by a promotion for a path over [start, end): the version before and after, and how far C moves.

    C is that of the curve that the path is served, through the cable that it has at `start`.
    """

    path: Scope
    start: Instant
    end: Instant | None
    before: str | None
    after: str | None
    curve_change: CurveChange | None


@dataclass(frozen=True)
class Plan:
    """Promotions that are wanted as one act, and what they change while `newest` is the number of the newest promotion.

    `left_out` says of versions that were meant why they are not promoted, by their ids.
    """

    wanted: Sequence[Promotion]
    changes: list[Change]
    newest: int
    left_out: Mapping[str, str] = field(default_factory=dict)


Describe = Callable[[Sequence[Promotion], list[Change]], Answer]


@dataclass(frozen=True)
class Promotions:
    """Writes the ledger."""

    database: Database
    instrument: Instrument
    clock: Callable[[], Instant]

    def plan(self, body: PromotionBody, by: str) -> Plan:
        """Work out a promotion and what it would change, while others may promote."""
        with self.database.read() as stores:
            wanted = [self._read(stores, body, by)]
            return Plan(wanted, self.changes(stores, wanted), stores.ledger.newest_number())

    def plan_job(self, number: int, body: ReasonBody, by: str) -> Plan:
        """Work out the promotion of all converged versions of a job that has ended, each for its own window."""
        with self.database.read() as stores:
            job = stores.jobs.get(number)
            if job.state in OPEN:
                raise ConflictError(f"job {number} is {job.state}: wait until it has ended")
            names = [name for result in job.results for name in result["calibrations"]]
            versions = stores.versions.get_many(names)
            good = [versions[name] for name in names if versions[name].status == CONVERGED]
            if not good:
                raise ConflictError(f"job {number} made no version that converged: nothing to promote")
            wanted = [_over_window(version, by, body.reason) for version in good]
            left_out = {name: v.status for name, v in versions.items() if v.status != CONVERGED}
            return Plan(wanted, self.changes(stores, wanted), stores.ledger.newest_number(), left_out)

    def plan_rollback(self, number: int, body: ReasonBody, by: str) -> Plan:
        """Work out how to undo a promotion and all that were one act with it, where they decide; nothing is written."""
        with self.database.read() as stores:
            act = stores.ledger.act_of(number)
            if not act:
                raise NotFoundError(f"no promotion {number}; GET /v1/calibrations/effective names those that answer")
            undoes = act[0].at
            undone, after = stores.ledger.undone(), stores.ledger.undone(undoes)
            while act[0].undoes is not None:  # undone itself, it brings back what it undid
                act = stores.ledger.act_at(act[0].undoes)
            since = min(p.valid_from for p in act)
            until = None if any(p.valid_to is None for p in act) else max(p.valid_to or 0 for p in act)
            scopes = {p.scope for p in act}
            was, becomes = (stores.ledger.standing(scopes, since, until, without=one) for one in (undone, after))
            having = was if act[0].at in after else becomes
            own = [
                one for p in act for one in list_deciding(having, p.scope, p.valid_from, p.valid_to) if one.at == p.at
            ]
            if undone == after or not own:
                now = stores.ledger.standing(scopes, since, until)
                deciding = [one for p in act for one in list_deciding(now, p.scope, p.valid_from, p.valid_to)]
                last = max(deciding, key=lambda one: one.number)
                raise ConflictError(
                    f"promotion {number} decides nowhere any more: for {last.scope.key} {last.calibration or 'nothing'}"
                    f" is in effect since {format_instant(last.at)[:10]}, by promotion {last.number}: roll that back"
                )
            wanted = [replace(one, undoes=undoes) for p in own for one in undo(p, becomes, by, body.reason)]
            return Plan(wanted, self.changes(stores, wanted), stores.ledger.newest_number())

    def promote(self, plan: Plan, describe: Describe[Answer]) -> Answer:
        """Promote, and describe what that changed; what cannot be described is not promoted.

        The changes are worked out again only if somebody else promoted since the plan was made.
        """
        with self.database.write() as stores:
            stores.ledger.lock()
            is_current = stores.ledger.newest_number() == plan.newest
            changes = plan.changes if is_current else self.changes(stores, plan.wanted)
            return describe(stores.ledger.append(plan.wanted, self.clock), changes)

    def _read(self, stores: Stores, body: PromotionBody, by: str) -> Promotion:
        stated = Scope(body.station, body.antenna, body.dipole)
        scope, version = stated, None
        if body.scope is not None and stated != Scope():
            raise BadInputError("body.scope", "no station, antenna or dipole beside the scope array", stated.key)
        if body.calibration is None:
            if stated == Scope() and body.scope is None:
                raise BadInputError("body", 'a station, or "scope": "array" to withdraw what the array has', "neither")
            select_paths(self.instrument, *scope.parts)
        else:
            version = stores.versions.get(body.calibration)
            scope = version.scope
            if stated not in (Scope(), scope) or (body.scope is not None and scope != Scope()):
                raise BadInputError("body", f"the scope of the version, {scope.key}", stated.key)
            if version.status != CONVERGED:
                raise ConflictError(f"calibration {version.id} cannot be promoted: its status is {version.status}")
        return Promotion(
            number=0,
            scope=scope,
            valid_from=parse_instant("body.valid_from", body.valid_from),
            valid_to=None if body.valid_to is None else parse_instant("body.valid_to", body.valid_to),
            calibration=None if version is None else version.id,
            at=LAST,
            by=by,
            reason=body.reason,
        )

    def changes(self, stores: Stores, wanted: Sequence[Promotion], made: Sequence[Version] = ()) -> list[Change]:
        """List the changes by promotions for every path that they answer; `made` are versions that are not stored."""
        # numbers order what shares its instant; the ledger gives others in the same order
        wanted = [replace(p, number=k) for k, p in enumerate(wanted)]
        new = {scope: [p for p in wanted if p.scope == scope] for scope in dict.fromkeys(p.scope for p in wanted)}
        paths = list(dict.fromkeys(path for s in new for path in select_paths(self.instrument, *s.parts)))
        since = min(p.valid_from for p in wanted)
        until = None if any(p.valid_to is None for p in wanted) else max(p.valid_to or 0 for p in wanted)
        of_scope: dict[Scope, list[Promotion]] = {}
        for promotion in stores.ledger.standing({s for path in paths for s in path.widening}, since, until):
            of_scope.setdefault(promotion.scope, []).append(promotion)
        found = []
        for path in paths:
            old = [p for scope in path.widening for p in of_scope.get(scope, [])]
            added = [p for scope in path.widening for p in new.get(scope, [])]
            found += _differences(path, timeline(old, path), timeline([*old, *added], path))
        ids = {version_id for change in found for version_id in (change.before, change.after) if version_id}
        versions = stores.versions.get_many(ids) | {version.id: version for version in made}
        return [_with_size(change, versions) for change in found]

    def foresee(self, stores: Stores, made: Sequence[Version], by: str, reason: str) -> list[Change]:
        """List the changes by versions with C that are not stored, each promoted for its window."""
        told = [_over_window(one, by, reason) for one in made if all(curve.c is not None for curve in one.curves)]
        return self.changes(stores, told, made) if told else []


def _over_window(version: Version, by: str, reason: str) -> Promotion:
    return Promotion(0, version.scope, *version.window, version.id, LAST, by, reason)


def undo(made: Promotion, before: Sequence[Promotion], by: str, reason: str) -> Iterator[Promotion]:
    """Promote again what a scope had before a promotion, stretch by stretch over its interval."""
    for stretch in timeline([p for p in before if p.scope == made.scope], made.scope):
        start = made.valid_from if stretch.start is None else max(stretch.start, made.valid_from)
        ends = [end for end in (stretch.end, made.valid_to) if end is not None]
        end = min(ends, default=None)
        if end is None or start < end:
            yield Promotion(0, made.scope, start, end, stretch.calibration, LAST, by, reason)


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
            changes[-1] = replace(last, end=end)
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
    before, after = (versions[name].serve(change.path, change.start).curve for name in (change.before, change.after))
    return replace(change, curve_change=compare_curves(before, after))


# Tags: a name for what the ledger said at an instant, which nobody can change any more.

SETTLED_US = 60_000_000
"""The ledger at an instant is final once this time has passed: promotions commit within 5 s of their `at`."""


@dataclass(frozen=True)
class Knowledge:
    """As of when the ledger is read: None is now. `text` is how an answer states it.

    `is_final`: no promotion can be made any more that this reading of the ledger would see.
    """

    as_of: Instant | None
    text: str | None
    is_final: bool


@dataclass(frozen=True)
class Tags:
    """Makes tags and reads them."""

    database: Database
    clock: Callable[[], Instant]

    def put(self, name: str, body: TagBody, by: str) -> tuple[Tag, bool]:
        """Freeze the ledger under a name, as it is now or was at `as_of`; the tag, and whether it is new."""
        wanted = None if body.as_of is None else self.read_past(body.as_of)
        with self.database.write() as stores:
            stores.ledger.lock()
            earlier = stores.tags.find(name)
            if earlier is not None:
                if earlier.reason != body.reason or wanted not in (None, earlier.as_of):
                    found = f"{format_instant(earlier.as_of)}, {earlier.reason!r}"
                    raise ConflictError(f"the tag {name} exists with another content: {found}; choose another name")
                return earlier, False
            now = self.clock()
            newest = stores.ledger.require_clocks(now)
            as_of = max(now, newest) if wanted is None else wanted
            tag = Tag(name, as_of, by, body.reason, now)
            stores.tags.add(tag)
            return tag, True

    def read_knowledge(self, as_of: str | None, tag: str | None) -> Knowledge:
        """Read the instant of knowledge of a query from its `as_of` or `tag`."""
        if tag is None:
            instant = None if as_of is None else self.read_past(as_of)
            return Knowledge(instant, as_of, instant is not None and instant < self.clock() - SETTLED_US)
        if as_of is not None:
            raise BadInputError("tag", "either tag or as_of", "both")
        with self.database.read() as stores:
            found = stores.tags.find(tag)
            names = [] if found else [one.name for one in stores.tags.after("", OFFERED)]
        if found is None:
            raise NotFoundError(f"no tag {offer_name(tag, names)}; GET /v1/tags lists them")
        return Knowledge(found.as_of, format_instant(found.as_of), is_final=True)

    def read_past(self, text: str) -> Instant:
        """Read an instant of knowledge, which is not later than now."""
        instant = parse_instant("as_of", text)
        if instant > self.clock():
            raise BadInputError("as_of", "an instant not later than now", format_instant(instant))
        return instant
