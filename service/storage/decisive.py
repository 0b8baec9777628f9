"""Which promotion decides: the newest that covers an instant, as the ledger stands now or as it was."""

from __future__ import annotations

from functools import cache
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    FromClause,
    ScalarSelect,
    Select,
    Text,
    and_,
    bindparam,
    cast,
    func,
    or_,
    select,
)
from sqlalchemy.dialects.postgresql import ARRAY

from lbacal_core.curves.validity import Instant
from service.schema.tables import promotion, standing


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
