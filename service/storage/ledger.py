"""The ledger of promotions: appended to under one lock, read at an instant as known at another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from sqlalchemy import Connection, Row, Select, func, or_, select, text

from lbacal_core.validity import Instant, Promotion, Scope
from service.errors import UnavailableError
from service.schema.tables import promotion

LOCK = 5_240_121
"""Names the one lock that orders promotions on PostgreSQL."""
MANY_KEYS = 500
PROMPT_US = 5_000_000
"""A promotion is committed within this time of its `at`, or not at all."""
AHEAD_US = 60_000_000
"""Clocks of servers may differ by this much."""


class LedgerStore:
    """Promotions are inserted, never changed."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._written: tuple[Instant, Callable[[], Instant]] | None = None

    def lock(self) -> None:
        """Wait until nobody else promotes; held until the transaction ends."""
        if self._connection.dialect.name == "postgresql":
            # a promoter that hangs must not stop the others, nor commit long after its `at`
            self._connection.execute(text("SET LOCAL lock_timeout = '30s'"))
            self._connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
            self._connection.execute(text("SET LOCAL statement_timeout = '5s'"))

    def append(self, wanted: Sequence[Promotion], clock: Callable[[], Instant]) -> list[Promotion]:
        """Write promotions as one act: the same `at`, later than any before. The last statement before the commit.

        `number` and `at` of what is wanted are replaced. Where the newest promotion is far ahead of the clock, one of
        the two clocks was wrong: what would be written now could not be read as of now.
        """
        if not wanted:
            return []
        self.lock()
        if self._connection.dialect.name == "postgresql":
            self._connection.execute(text(f"SET LOCAL idle_in_transaction_session_timeout = {PROMPT_US // 1000}"))
        newest = self._connection.execute(select(func.max(promotion.c.at_us))).scalar_one()
        now = clock()
        if newest is not None and newest > now + AHEAD_US:
            raise UnavailableError(
                f"the newest promotion was made {(newest - now) / 1e6:.0f} s ahead of this server's clock: one of the "
                "two clocks is wrong, and until that instant nothing can be promoted"
            )
        at = max(now, (newest or 0) + 1)
        self._written = now, clock
        rows = [
            {
                "scope": p.scope.key, "station": p.scope.station, "antenna": p.scope.antenna, "dipole": p.scope.dipole,
                "valid_from_us": p.valid_from, "valid_to_us": p.valid_to, "calibration": p.calibration,
                "at_us": at, "by": p.by, "reason": p.reason,
            }
            for p in wanted
        ]  # fmt: skip
        statement = promotion.insert().returning(promotion, sort_by_parameter_order=True)
        return [_value(row) for row in self._connection.execute(statement, rows)]

    def require_prompt(self) -> None:
        """Refuse, just before the commit, promotions whose instant is past: they would change what was answered."""
        if self._written is not None:
            read, clock = self._written
            if clock() > read + PROMPT_US:
                raise UnavailableError("the promotion took too long to write and was not made")

    def answers(self, paths: Sequence[Scope], instant: Instant, as_of: Instant | None) -> dict[Scope, list[Promotion]]:
        """The promotions of each path's scopes at an instant, narrowest first, up to the one that answers."""
        keys = {scope.key for path in paths for scope in path.widening}
        rank = func.row_number().over(
            partition_by=promotion.c.scope, order_by=(promotion.c.at_us.desc(), promotion.c.id.desc())
        )
        covering = _as_of(select(promotion, rank.label("rank")), as_of).where(
            promotion.c.valid_from_us <= instant,
            or_(promotion.c.valid_to_us.is_(None), promotion.c.valid_to_us > instant),
        )
        if len(keys) <= MANY_KEYS:
            covering = covering.where(promotion.c.scope.in_(sorted(keys)))
        ranked = covering.subquery()
        rows = self._connection.execute(select(ranked).where(ranked.c.rank == 1))
        decisive = {found.scope: found for found in map(_value, rows)}
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

    def of_scopes(self, scopes: Iterable[Scope], as_of: Instant | None = None) -> list[Promotion]:
        """Every promotion of some scopes, oldest first."""
        keys = sorted({scope.key for scope in scopes})
        statement = _as_of(select(promotion), as_of).order_by(promotion.c.at_us, promotion.c.id)
        if len(keys) <= MANY_KEYS:
            return [_value(row) for row in self._connection.execute(statement.where(promotion.c.scope.in_(keys)))]
        wanted = set(keys)
        return [_value(row) for row in self._connection.execute(statement) if row.scope in wanted]

    def of_calibration(self, calibration: str) -> list[Promotion]:
        """Every promotion of a version, oldest first."""
        statement = select(promotion).where(promotion.c.calibration == calibration)
        return [_value(row) for row in self._connection.execute(statement.order_by(promotion.c.at_us, promotion.c.id))]

    def recent(self, limit: int) -> list[Promotion]:
        """The newest promotions, newest first."""
        statement = select(promotion).order_by(promotion.c.at_us.desc(), promotion.c.id.desc()).limit(limit)
        return [_value(row) for row in self._connection.execute(statement)]


def _as_of(statement: Select[Any], as_of: Instant | None) -> Select[Any]:
    return statement if as_of is None else statement.where(promotion.c.at_us <= as_of)


def _value(row: Row[Any]) -> Promotion:
    return Promotion(
        number=row.id,
        scope=Scope(row.station, row.antenna, row.dipole),
        valid_from=row.valid_from_us,
        valid_to=row.valid_to_us,
        calibration=row.calibration,
        at=row.at_us,
        by=row.by,
        reason=row.reason,
    )
