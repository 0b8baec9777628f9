"""What is put into effect and taken out of it, and the names under which that is frozen."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response

from lbacal_core.curves.validity import Promotion
from service.factory import Factory
from service.handlers.request import JobNumber, JsonBody, Limit, UseCases, answer, caller_with
from service.handlers.routes import Order, acts, ordered, page_of, reads
from service.usecases.keys import Caller
from service.usecases.promotions import Change, Plan
from service.wire.answer_models import (
    ChangeAnswer,
    ChangesAnswer,
    PromotionAnswer,
    PromotionLine,
    PromotionsAnswer,
    TagAnswer,
    TagsAnswer,
)
from service.wire.answers import describe_scope, fill_answer, to_json
from service.wire.bodies import PromotionBody, ReasonBody, TagBody, parse_body

router = APIRouter(tags=["ledger"])
PROMOTE = "calibrations:promote"
Promoter = Annotated[Caller, caller_with(PROMOTE)]
Reasoned = Annotated[Order[ReasonBody], ordered(ReasonBody, PROMOTE)]
Describe = Callable[[Plan, Sequence[Promotion], Sequence[Change]], dict[str, Any]]
TAG_NAME = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]{0,79}$")
TagName = Annotated[str, Path(pattern=TAG_NAME.pattern)]


@reads(router, "/v1/tags", TagsAnswer)
def list_tags(
    request: Request,
    use: UseCases,
    cursor: Annotated[str, Query(pattern=r"^[A-Za-z0-9._-]{0,80}$")] = "",
    limit: Limit = 100,
) -> Response:
    """List tags.

    In order of their names; `next` is the cursor of the next page.
    """
    tags = use.database.look(lambda stores: stores.tags.after(cursor, limit))
    return answer(request, page_of("tags", tags, limit, partial(fill_answer, TagAnswer), attrgetter("name")))


@acts(router, "/v1/tags/{name}", TagBody, TagAnswer, 409, method="PUT", otherwise=TagAnswer)
def put_tag(request: Request, use: UseCases, caller: Promoter, name: TagName, body: JsonBody) -> Response:
    """Freeze the ledger under a name.

    As it was known at `as_of`, or as it is now. The same again is 200, another content 409.
    """
    tag, is_new = use.tags.put(name, parse_body(TagBody, body), caller.name)
    return answer(request, fill_answer(TagAnswer, tag), status=201 if is_new else 200)


@acts(router, "/v1/promotions", PromotionBody, PromotionAnswer, 404, 409, otherwise=ChangesAnswer)
def promote(
    request: Request,
    use: UseCases,
    order: Annotated[Order[PromotionBody], ordered(PromotionBody, PROMOTE)],
    dry_run: bool = False,
) -> Response:
    """Promote a version for an interval, or withdraw.

    `dry_run=true` answers 200 with the changes and writes nothing.
    """
    plan = use.promotions.plan(order.wanted, order.caller)
    return _execute(request, use, order, plan, "promotion", describe_promoted, dry_run=dry_run)


@acts(router, "/v1/jobs/{number}/promotion", ReasonBody, PromotionsAnswer, 404, 409, otherwise=PromotionsAnswer)
def promote_job(request: Request, use: UseCases, order: Reasoned, number: JobNumber, dry_run: bool = False) -> Response:
    """Promote all versions of a job.

    Those that converged, each for the window of its fit, as one act. `dry_run=true` answers 200 with the changes and
    writes nothing.
    """
    plan = use.promotions.plan_job(number, order.wanted, order.caller)
    return _execute(request, use, order, plan, f"promotion of job {number}", describe_act, dry_run=dry_run)


@acts(router, "/v1/promotions/{number}/rollback", ReasonBody, PromotionsAnswer, 404, 409, otherwise=PromotionsAnswer)
def roll_back(request: Request, use: UseCases, order: Reasoned, number: JobNumber, dry_run: bool = False) -> Response:
    """Undo a promotion.

    Promotes again what its scope had before, a withdrawal where it had nothing; and the same for all promotions that
    were one act with it, each where it still decides; 409 where none does. `dry_run=true` answers 200, writes nothing.
    """
    plan = use.promotions.plan_rollback(number, order.wanted, order.caller)
    return _execute(request, use, order, plan, f"rollback of {number}", describe_act, dry_run=dry_run)


def _execute(
    request: Request, use: Factory, order: Order[Any], plan: Plan, what: str, describe: Describe, *, dry_run: bool
) -> Response:
    if dry_run:
        return answer(request, describe(plan, [], plan.changes))
    done = order.once(what, lambda: use.promotions.promote(plan, lambda *made: to_json(describe(plan, *made))))
    return answer(request, done, status=201)


def describe_promoted(_plan: Plan, made: Sequence[Promotion], changes: Sequence[Change]) -> dict[str, Any]:
    """Describe the `changes` by one promotion, with the fields of `PromotionLine` where it was made."""
    line = fill_answer(PromotionLine, made[0], promotion=made[0].number) if made else {}
    return {**line, "changes": describe_changes(changes)}


def describe_act(plan: Plan, made: Sequence[Promotion], changes: Sequence[Change]) -> dict[str, Any]:
    """Describe promotions that are one act: `changes`, `promotions` (empty before they are made), `left_out`."""
    promotions = [fill_answer(PromotionLine, one, promotion=one.number) for one in made]
    return {"changes": describe_changes(changes), "promotions": promotions, "left_out": dict(plan.left_out)}


def describe_changes(changes: Sequence[Change]) -> list[dict[str, Any]]:
    """Describe the changes by promotions, path by path, as JSON values of `ChangeAnswer`."""
    unknown = dict.fromkeys(("max_fraction", "max_sigma", "mean_c"))
    return [fill_answer(ChangeAnswer, one, one.curve_change or unknown, **describe_scope(one.path)) for one in changes]
