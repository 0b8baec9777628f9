"""The ledger of promotions: appended to under one lock, read at an instant as known at another."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    FromClause,
    Row,
    ScalarSelect,
    Select,
    Text,
    and_,
    bindparam,
    cast,
    func,
    or_,
    select,
    text,
    update,
)
from sqlalchemy.dialects.postgresql import ARRAY

from lbacal_core.curves.validity import Instant, Promotion, Scope
from service.errors import UnavailableError
from service.schema.tables import edge, model_change, promotion, standing, tag
from service.storage.processes import SCHEDULER, read_database_clock
from service.storage.rows import Store, add_rows, from_row, put_rows, scope_columns, to_row

# Which promotion decides: the newest that covers an instant, as the ledger stands now or as it was.


@cache
def state_decisive(is_postgresql: bool, *, is_pinned: bool) -> Select[Any]:
    """The statement for the promotion that decides each pair of a scope and an instant; to make it takes long."""
    if is_postgresql:
        sent = cast(bindparam("scopes"), ARRAY(Text)), cast(bindparam("instants"), ARRAY(BigInteger))
        pairs: FromClause = func.unnest(*sent).table_valued("scope", "instant").render_derived()
    else:
        each = func.json_each(bindparam("pairs")).table_valued("value")
        names = enumerate(("scope", "instant"))
        pairs = select(*(func.json_extract(each.c.value, f"$[{k}]").label(name) for k, name in names)).subquery()
    return _decide_as_of(pairs) if is_pinned else _decide_now(pairs)


def _decide_now(pairs: FromClause) -> Select[Any]:
    """The promotion made last decides, among those that stand in the scope, one for each interval."""
    covers = and_(
        standing.c.scope == pairs.c.scope,
        standing.c.valid_from_us <= pairs.c.instant,
        standing.c.valid_to_us > pairs.c.instant,
    )
    newest = select(pairs.c.instant, func.max(standing.c.promotion).label("promotion")).join(standing, covers)
    last = newest.group_by(pairs.c.scope, pairs.c.instant).subquery()
    return select(promotion, last.c.instant).join(last, last.c.promotion == promotion.c.id)


def _decide_as_of(pairs: FromClause) -> Select[Any]:
    """The ledger as it was is gone through from its newest promotion back.

    Whether anything begins before the instant and ends after it is asked first: where nothing does, as in the gap
    after the last window, the promotions of the scope need not be gone through.
    """
    some = promotion.alias()
    of_scope = select(some.c.id).where(some.c.scope == pairs.c.scope).correlate(pairs)
    may_be_covered = and_(
        of_scope.where(some.c.valid_from_us <= pairs.c.instant).exists(),
        or_(
            of_scope.where(some.c.valid_to_us > pairs.c.instant).exists(),
            of_scope.where(some.c.valid_to_us.is_(None)).exists(),
        ),
    )
    newest = newest_of(pairs.c.scope, pairs.c.instant, bindparam("as_of", type_=BigInteger), pairs, "id")
    statement = select(promotion, pairs.c.instant).select_from(pairs).join(promotion, promotion.c.id == newest)
    return statement.where(may_be_covered)


def newest_of(
    scope: ColumnElement[str],
    instant: ColumnElement[int],
    as_of: Instant | ColumnElement[int] | None,
    outer: FromClause,
    column: str,
) -> ScalarSelect[Any]:
    """A column of the newest promotion of a scope that covers an instant, both columns of an outer query."""
    inner = promotion.alias()
    statement = select(inner.c[column]).where(
        inner.c.scope == scope,
        inner.c.valid_from_us <= instant,
        or_(inner.c.valid_to_us.is_(None), inner.c.valid_to_us > instant),
    )
    if as_of is not None:
        statement = statement.where(inner.c.at_us <= as_of)
    return statement.order_by(inner.c.at_us.desc(), inner.c.id.desc()).limit(1).correlate(outer).scalar_subquery()


LOCK = 5_240_121
"""Names the one lock that orders promotions on PostgreSQL."""
PROMPT_US = 5_000_000
"""A promotion is committed within this time of its `at`, or not at all."""
OPEN_END = 2**63 - 1
"""The end of an open interval in the table `standing`, whose key has no null."""
AHEAD_US = 60_000_000
"""Clocks of servers may differ by this much."""


@dataclass(frozen=True)
class Neighbour:
    """The promotion that answers nearest to a gap, and the instant at which it ends or begins to.

    `last` is the nearest instant at which it answers: an end is not of its interval.
    """

    instant: Instant
    promotion: Promotion
    last: Instant


Neighbours = tuple[Neighbour | None, Neighbour | None]
"""The one before a gap and the one after it."""


def is_of_person(withdrawal: Promotion) -> bool:
    """Whether a person withdrew, over which due work promotes nothing."""
    return withdrawal.calibration is None and withdrawal.by != SCHEDULER


def pick_answering(asked: Mapping[Scope, Sequence[Promotion]]) -> dict[Scope, Promotion]:
    """The promotion that answers for each path that has one, of those that `LedgerStore.answers` found."""
    return {path: said[-1] for path, said in asked.items() if said and said[-1].calibration is not None}


class LedgerStore(Store):
    """Promotions are inserted, never changed."""

    _written: tuple[Instant, Callable[[], Instant]] | None = None

    def lock(self) -> None:
        """Wait until nobody else promotes; held until the transaction ends."""
        if self._connection.dialect.name == "postgresql":
            # a promoter that hangs must not stop the others, nor commit long after its `at`
            self._connection.execute(text("SET LOCAL lock_timeout = '30s'"))
            self._connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
            self._connection.execute(text("SET LOCAL statement_timeout = '5s'"))

    def append(self, wanted: Sequence[Promotion], clock: Callable[[], Instant]) -> list[Promotion]:
        """Write promotions as one act: the same `at`, later than any before. The last statement before the commit.

        `at` is later than every tag, too: what a tag froze stays what it was. `number` and `at` of what is wanted are
        replaced.
        """
        if not wanted:
            return []
        self.lock()
        if self._connection.dialect.name == "postgresql":
            self._connection.execute(text(f"SET LOCAL idle_in_transaction_session_timeout = {PROMPT_US // 1000}"))
        now = clock()
        at = max(now, self.require_clocks(now) + 1)
        self._written = now, clock
        rows = [to_row(one, promotion, **scope_columns(one.scope), at_us=at) for one in wanted]
        statement = promotion.insert().returning(promotion, sort_by_parameter_order=True)
        made = [_value(row) for row in self._connection.execute(statement, rows)]
        self._let_stand(made)
        return made

    def require_clocks(self, now: Instant) -> Instant:
        """The newest instant of the ledger; refused where this server's clock, or the ledger, is far ahead.

        What a clock ahead writes stops everybody until that instant, and cannot be read as of now.
        """
        true, newest = read_database_clock(self._connection), self.newest_instant() or 0
        if now > true + AHEAD_US:
            raise UnavailableError(
                f"this server's clock is {(now - true) / 1e6:.0f} s ahead of the database's: nothing is promoted or "
                "tagged until it is set right"
            )
        if newest > now + AHEAD_US:
            cure = "run `lbacal db repair-clock`" if newest > true + AHEAD_US else "this server's clock is behind"
            raise UnavailableError(
                f"the newest promotion or tag was made {(newest - now) / 1e6:.0f} s ahead of this server's clock, and "
                f"until that instant nothing can be promoted: {cure}"
            )
        return newest

    def repair_clock(self) -> dict[Instant, Instant]:
        """Move what a clock ahead wrote to now, by the database's clock, in its order; was and is of each instant.

        No line goes, and no answer changes: as of an instant until now nothing of it was seen, and a tag keeps what it
        has frozen so far.
        """
        self.lock()
        now = read_database_clock(self._connection)
        columns = promotion.c.at_us, edge.c.known_us, tag.c.as_of_us, tag.c.at_us, model_change.c.at_us
        ahead = {
            at for one in columns for at in self._connection.execute(select(one).where(one > now + AHEAD_US)).scalars()
        }
        rest = [
            self._connection.execute(select(func.max(one)).where(one <= now + AHEAD_US)).scalar() for one in columns
        ]
        first = max([now, *(at + 1 for at in rest if at is not None)])
        moved = {at: first + k for k, at in enumerate(sorted(ahead))}
        for one in columns:
            for was, at in moved.items():
                self._connection.execute(update(one.table).where(one == was).values({one.name: at}))
        return moved

    def _let_stand(self, made: Sequence[Promotion]) -> None:
        """Put promotions in place of those of the same scope and interval, and add their edges that are new."""
        newest = {(p.scope.key, p.valid_from, OPEN_END if p.valid_to is None else p.valid_to): p.number for p in made}
        keys = ("scope", "valid_from_us", "valid_to_us")
        rows = [dict(zip((*keys, "promotion"), (*key, number), strict=True)) for key, number in sorted(newest.items())]
        put_rows(self._connection, standing, rows)
        edges = {
            (p.scope.station or "", end): p.at for p in made for end in (p.valid_from, p.valid_to) if end is not None
        }
        rows = [{"station": station, "at_us": end, "known_us": at} for (station, end), at in sorted(edges.items())]
        add_rows(self._connection, edge, rows)

    def require_prompt(self) -> None:
        """Refuse, just before the commit, promotions whose instant is past: they would change what was answered."""
        if self._written is not None:
            read, clock = self._written
            if clock() > read + PROMPT_US:
                raise UnavailableError("the promotion took too long to write and was not made")

    def answers(self, paths: Sequence[Scope], instant: Instant, as_of: Instant | None) -> dict[Scope, list[Promotion]]:
        """The promotions of each path's scopes at an instant, narrowest first, up to the one that answers."""
        scopes = {scope for path in paths for scope in path.widening}
        decisive = self.decisive(scopes, instant, as_of)
        answers = {}
        for path in paths:
            asked: list[Promotion] = []
            for scope in path.widening:
                if scope in decisive:
                    asked.append(decisive[scope])
                    if decisive[scope].calibration is not None:
                        break
            answers[path] = asked
        return answers

    def decisive(self, scopes: Iterable[Scope], instant: Instant, as_of: Instant | None) -> dict[Scope, Promotion]:
        """The newest promotion of each scope that covers an instant, a withdrawal too."""
        found = self.decisive_at([(scope, instant) for scope in scopes], as_of)
        return {scope: promotion for (scope, _), promotion in found.items()}

    def versions_at(self, scopes: Iterable[Scope], instant: Instant) -> dict[Scope, str]:
        """The version of each scope's own in effect at an instant, as the ledger stands now; left out where none is."""
        said = self.decisive(scopes, instant, None)
        return {scope: made.calibration for scope, made in said.items() if made.calibration is not None}

    def decisive_at(
        self, asked: Iterable[tuple[Scope, Instant]], as_of: Instant | None = None
    ) -> dict[tuple[Scope, Instant], Promotion]:
        """The newest promotion of scopes that covers an instant of each, as the ledger stands now or stood."""
        pairs = sorted({(scope.key, instant) for scope, instant in asked})
        is_postgresql = self._connection.dialect.name == "postgresql"
        if is_postgresql:
            bound: dict[str, Any] = {"scopes": [key for key, _ in pairs], "instants": [instant for _, instant in pairs]}
        else:
            bound = {"pairs": json.dumps(pairs)}
        if as_of is not None:
            bound["as_of"] = as_of
        rows = self._connection.execute(state_decisive(is_postgresql, is_pinned=as_of is not None), bound)
        return {(made.scope, row.instant): made for row in rows for made in [_value(row)]}

    def bridging(
        self, dates: Iterable[tuple[Scope, Instant]], as_of: Instant | None = None
    ) -> dict[tuple[Scope, Instant], Promotion]:
        """The newer promotion of the version that decides just before a date and at it; left out where two do, or none.

        By scope and date.
        """
        sides = {(scope, date): ((scope, date - 1), (scope, date)) for scope, date in dates}
        said = self.decisive_at((one for of in sides.values() for one in of), as_of) if sides else {}
        asked = sides.items()
        both = {of: (said[before], said[at]) for of, (before, at) in asked if before in said and at in said}
        return {
            of: max(before, after, key=lambda one: one.number)
            for of, (before, after) in both.items()
            if before.calibration is not None and before.calibration == after.calibration
        }

    def latest(self, scopes: Iterable[Scope]) -> dict[Scope, Promotion]:
        """The promotion in effect at the begin of the last interval of each scope that has one, as it stands now."""
        of_key = {scope.key: scope for scope in scopes}
        keys = self._keys(of_key)
        statement = select(standing.c.scope, func.max(standing.c.valid_from_us)).group_by(standing.c.scope)
        statement = statement.join(keys, keys.c.value == standing.c.scope)
        statement = statement.join(promotion, promotion.c.id == standing.c.promotion)
        rows = self._connection.execute(statement.where(promotion.c.calibration.is_not(None))).all()
        return {scope: made for (scope, _), made in self.decisive_at((of_key[key], at) for key, at in rows).items()}

    def neighbours(
        self, scopes_of: Mapping[Scope, Sequence[Scope]], instant: Instant, as_of: Instant | None
    ) -> dict[Scope, Neighbours]:
        """The nearest promotions before and after an instant at which nothing answers, in two queries.

        None where there is none. Any of its scopes may answer for a path: its neighbour is the nearest of theirs, the
        first of equally near.
        """
        edges = self._edges({scope.key for scopes in scopes_of.values() for scope in scopes}, instant, as_of)
        last: dict[Scope, tuple[Instant, Scope]] = {}
        first: dict[Scope, tuple[Instant, Scope]] = {}
        for one, scopes in scopes_of.items():
            ends = [(end, scope) for scope in scopes if (end := edges[scope.key][0]) is not None]
            starts = [(start, scope) for scope in scopes if (start := edges[scope.key][1]) is not None]
            if ends:
                last[one] = max(ends, key=lambda end: end[0])
            if starts:
                first[one] = min(starts, key=lambda start: start[0])
        asked = [(scope, end - 1) for end, scope in last.values()] + [(scope, start) for start, scope in first.values()]
        decisive = self.decisive_at(asked, as_of)
        before = {one: Neighbour(end, decisive[scope, end - 1], end - 1) for one, (end, scope) in last.items()}
        after = {one: Neighbour(start, decisive[scope, start], start) for one, (start, scope) in first.items()}
        return {one: (before.get(one), after.get(one)) for one in scopes_of}

    def edges(self, as_of: Instant) -> dict[str | None, set[Instant]]:
        """Where intervals begin or end, by station (None: those of the array), as known at an instant."""
        found: dict[str | None, set[Instant]] = {}
        for row in self._connection.execute(select(edge).where(edge.c.known_us <= as_of)):
            found.setdefault(row.station or None, set()).add(row.at_us)
        return found

    def act_of(self, number: int) -> list[Promotion]:
        """A promotion and those that were one act with it, in order of their numbers; empty if there is none."""
        return self.act_at(select(promotion.c.at_us).where(promotion.c.id == number).scalar_subquery())

    def act_at(self, at: Instant | ScalarSelect[Any]) -> list[Promotion]:
        """The promotions of an instant, which were one act, in order of their numbers."""
        statement = select(promotion).where(promotion.c.at_us == at).order_by(promotion.c.id)
        return [_value(row) for row in self._connection.execute(statement)]

    def undone(self, *also: Instant) -> set[Instant]:
        """The instants of the acts that rollbacks undo, a rollback that is itself undone aside; `also` acts are."""
        found = set(also)
        undoing = select(promotion.c.at_us, promotion.c.undoes_us).where(promotion.c.undoes_us.is_not(None)).distinct()
        for at, of in self._connection.execute(undoing.order_by(promotion.c.at_us.desc())):
            found |= set() if at in found else {of}
        return found

    def standing(
        self,
        scopes: Iterable[Scope],
        since: Instant | None = None,
        until: Instant | None = None,
        before: Instant | None = None,
        without: set[Instant] | None = None,
    ) -> list[Promotion]:
        """The promotions that can decide somewhere in [since, until), oldest first: the newest of each interval.

        Later ids have later instants `at`, so the largest id of an interval is its newest promotion. With `before` only
        promotions made before that instant count, and with `without` neither rollbacks nor the acts of these instants:
        then all are gone through, and not only those that stand now.
        """
        keys = self._keys({scope.key for scope in scopes})
        if before is None and without is None:
            return self._standing_now(keys, since, until)
        newest = select(func.max(promotion.c.id)).where(promotion.c.scope.in_(select(keys.c.value)))
        if since is not None:
            newest = newest.where(or_(promotion.c.valid_to_us.is_(None), promotion.c.valid_to_us > since))
        if until is not None:
            newest = newest.where(promotion.c.valid_from_us < until)
        if before is not None:
            newest = newest.where(promotion.c.at_us < before)
        if without is not None:
            newest = newest.where(promotion.c.undoes_us.is_(None), promotion.c.at_us.not_in(without))
        newest = newest.group_by(promotion.c.scope, promotion.c.valid_from_us, promotion.c.valid_to_us)
        statement = select(promotion).where(promotion.c.id.in_(newest)).order_by(promotion.c.id)
        return [_value(row) for row in self._connection.execute(statement)]

    def withdrawn(self, scopes: Iterable[Scope]) -> list[Promotion]:
        """The promotions that withdrew what some scopes had, oldest first, whatever followed."""
        keys = self._keys({scope.key for scope in scopes})
        asked = select(promotion).where(promotion.c.scope.in_(select(keys.c.value)), promotion.c.calibration.is_(None))
        return [_value(row) for row in self._connection.execute(asked.order_by(promotion.c.id))]

    def _standing_now(self, keys: FromClause, since: Instant | None, until: Instant | None) -> list[Promotion]:
        statement = select(promotion).join(standing, standing.c.promotion == promotion.c.id)
        statement = statement.join(keys, keys.c.value == standing.c.scope)
        if since is not None:
            statement = statement.where(standing.c.valid_to_us > since)
        if until is not None:
            statement = statement.where(standing.c.valid_from_us < until)
        return [_value(row) for row in self._connection.execute(statement.order_by(promotion.c.id))]

    def all_standing(self) -> list[Promotion]:
        """All promotions that can decide somewhere, oldest first."""
        statement = select(promotion).join(standing, standing.c.promotion == promotion.c.id)
        return [_value(row) for row in self._connection.execute(statement.order_by(promotion.c.id))]

    def newest_instant(self) -> Instant | None:
        """The instant of the newest promotion or tag, before which nothing can be promoted any more; None without."""
        instants = select(func.max(promotion.c.at_us)).union_all(select(func.max(tag.c.as_of_us)))
        return max((one for one in self._connection.execute(instants).scalars() if one is not None), default=None)

    def newest_number(self) -> int:
        """The number of the newest promotion; 0 if there is none."""
        return self._connection.execute(select(func.max(promotion.c.id))).scalar_one() or 0

    def of_calibration(self, calibration: str, limit: int) -> list[Promotion]:
        """The newest promotions of a version, oldest first."""
        statement = select(promotion).where(promotion.c.calibration == calibration)
        newest = statement.order_by(promotion.c.at_us.desc(), promotion.c.id.desc()).limit(limit)
        return [_value(row) for row in self._connection.execute(newest)][::-1]

    def of_interval(self, scope: Scope, since: Instant, until: Instant, limit: int) -> list[Promotion]:
        """The newest promotions of versions for just an interval of a scope, newest first."""
        is_it = (promotion.c.scope == scope.key) & (promotion.c.valid_from_us == since)
        statement = select(promotion).where(
            is_it, promotion.c.valid_to_us == until, promotion.c.calibration.is_not(None)
        )
        return [_value(row) for row in self._connection.execute(statement.order_by(promotion.c.id.desc()).limit(limit))]

    def _edges(
        self, keys: Iterable[str], instant: Instant, as_of: Instant | None
    ) -> dict[str, tuple[Instant | None, Instant | None]]:
        """The last instant at which a version of each scope ceased to answer, and the next at which one begins to.

        A version ceases where its interval ends or a withdrawal begins, and begins where its interval does or where a
        withdrawal ends, each only if the ledger answers on that side of it. Indexes are walked away from the instant.
        """
        of, edge = self._keys(keys), promotion.alias()
        starts, ends, has_version = edge.c.valid_from_us, edge.c.valid_to_us, edge.c.calibration.is_not(None)

        def nearest(at: ColumnElement[int], is_kind: ColumnElement[bool], *, is_before: bool) -> ScalarSelect[int]:
            answers = newest_of(edge.c.scope, at - 1 if is_before else at, as_of, edge, "calibration")
            statement = select(at).where(edge.c.scope == of.c.value, is_kind, answers.is_not(None))
            statement = statement.where(at <= instant if is_before else at > instant)
            if as_of is not None:
                statement = statement.where(edge.c.at_us <= as_of)
            return statement.order_by(at.desc() if is_before else at).limit(1).correlate(of).scalar_subquery()

        statement = select(
            of.c.value,
            nearest(ends, has_version, is_before=True),
            nearest(starts, ~has_version, is_before=True),
            nearest(starts, has_version, is_before=False),
            nearest(ends, ~has_version, is_before=False),
        )
        return {
            key: (
                max((end for end in (version_end, withdrawn_from) if end is not None), default=None),
                min((start for start in (version_start, withdrawn_to) if start is not None), default=None),
            )
            for key, version_end, withdrawn_from, version_start, withdrawn_to in self._connection.execute(statement)
        }

    def _keys(self, keys: Iterable[str]) -> FromClause:
        """Scopes as a table of one column, `value`."""
        if self._connection.dialect.name == "postgresql":
            return func.unnest(cast(sorted(keys), ARRAY(Text))).table_valued("value").render_derived()
        return func.json_each(json.dumps(sorted(keys))).table_valued("value")


def _value(row: Row[Any]) -> Promotion:
    # by position and not by `from_row`: an answer about all paths reads thousands
    scope = Scope(row.station, row.antenna, row.dipole)
    interval = row.valid_from_us, row.valid_to_us
    return Promotion(row.id, scope, *interval, row.calibration, row.at_us, row.by, row.reason, row.undoes_us)


# Tags: names under which the ledger is frozen at an instant.


@dataclass(frozen=True)
class Tag:
    """A name for the ledger as it was known at `as_of`; who gave it, when and why."""

    name: str
    as_of: Instant
    by: str
    reason: str
    at: Instant


class TagStore(Store):
    """Tags are made once and never changed."""

    def find(self, name: str) -> Tag | None:
        """Find a tag by its name; None where there is none."""
        row = self._connection.execute(select(tag).where(tag.c.name == name)).one_or_none()
        return None if row is None else from_row(Tag, row)

    def add(self, new: Tag) -> None:
        """Write a tag; under the lock of the ledger."""
        self._connection.execute(tag.insert().values(to_row(new, tag)))

    def after(self, cursor: str, limit: int) -> Sequence[Tag]:
        """Tags in order of their names, after a cursor."""
        statement = select(tag).where(tag.c.name > cursor).order_by(tag.c.name).limit(limit)
        return [from_row(Tag, row) for row in self._connection.execute(statement)]
