"""What else the ledger takes: tags, and all versions of a job at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from lbacal_core.curves.validity import Promotion
from service.factory import Factory
from service.handlers.calibrations import describe_changes
from service.handlers.problems import document
from service.handlers.request import (
    IdempotencyKey,
    JobNumber,
    JsonBody,
    Limit,
    UseCases,
    answer,
    caller_with,
    describes,
    require_read,
)
from service.usecases.keys import Caller
from service.usecases.promotions import Change, Plan
from service.wire.answer_models import PromotionsAnswer, TagAnswer, TagsAnswer
from service.wire.answers import describe_promotion, fill_answer, to_json
from service.wire.bodies import ReasonBody, TagBody, parse_body

router = APIRouter(tags=["ledger"])
Promoter = Annotated[Caller, caller_with("calibrations:promote")]
TagName = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,79}$")]


@router.get(
    "/v1/tags",
    response_model=TagsAnswer,
    summary="List tags",
    description="In order of their names; `next` is the cursor of the next page.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_tags(
    request: Request,
    use: UseCases,
    cursor: Annotated[str, Query(pattern=r"^[A-Za-z0-9._-]{0,80}$")] = "",
    limit: Limit = 100,
) -> Response:
    tags = use.tags.after(cursor, limit)
    following = tags[-1].name if len(tags) == limit else None
    return answer(request, {"tags": [fill_answer(TagAnswer, tag) for tag in tags], "next": following})


@router.put(
    "/v1/tags/{name}",
    status_code=201,
    response_model=TagAnswer,
    summary="Freeze the ledger under a name",
    description="As it was known at `as_of`, or as it is now. The same again is 200, another content 409.",
    responses=document(400, 401, 403, 409, 415, 422, 503) | {200: {"model": TagAnswer}},
    openapi_extra=describes(TagBody),
)
def put_tag(request: Request, use: UseCases, caller: Promoter, name: TagName, body: JsonBody) -> Response:
    tag, is_new = use.tags.put(name, parse_body(TagBody, body), caller.name)
    return answer(request, fill_answer(TagAnswer, tag), status=201 if is_new else 200)


@router.post(
    "/v1/jobs/{number}/promotion",
    status_code=201,
    response_model=PromotionsAnswer,
    summary="Promote all versions of a job",
    description="Those that converged, each for the window of its fit, as one act. `dry_run=true` answers 200 with the "
    "changes and writes nothing.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503) | {200: {"model": PromotionsAnswer}},
    openapi_extra=describes(ReasonBody),
)
def promote_job(
    request: Request,
    use: UseCases,
    caller: Promoter,
    number: JobNumber,
    body: JsonBody,
    dry_run: bool = False,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    plan = use.promotions.plan_job(number, parse_body(ReasonBody, body), caller.name)
    asked = b"promotion of job %d" % number + body
    return _execute(request, use, caller, plan, asked, idempotency_key, dry_run=dry_run)


@router.post(
    "/v1/promotions/{number}/rollback",
    status_code=201,
    response_model=PromotionsAnswer,
    summary="Undo a promotion",
    description="Promotes again what its scope had before over its interval, a withdrawal where it had nothing; and "
    "the same for all promotions that were one act with it. `dry_run=true` answers 200 and writes nothing.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503) | {200: {"model": PromotionsAnswer}},
    openapi_extra=describes(ReasonBody),
)
def roll_back(
    request: Request,
    use: UseCases,
    caller: Promoter,
    number: JobNumber,
    body: JsonBody,
    dry_run: bool = False,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    plan = use.promotions.plan_rollback(number, parse_body(ReasonBody, body), caller.name)
    return _execute(request, use, caller, plan, b"rollback of %d" % number + body, idempotency_key, dry_run=dry_run)


def _execute(
    request: Request, use: Factory, caller: Caller, plan: Plan, asked: bytes, key: str | None, *, dry_run: bool
) -> Response:
    if dry_run:
        return answer(request, describe_act(plan, [], plan.changes))
    content = use.deeds.once(
        caller.name, key, asked, lambda: use.promotions.promote(plan, lambda *made: to_json(describe_act(plan, *made)))
    )
    return answer(request, content, status=201)


def describe_act(plan: Plan, made: Sequence[Promotion], changes: list[Change]) -> dict[str, Any]:
    """What promotions change that are one act; with the promotions where they were made."""
    return {
        **describe_changes(None, changes),
        "promotions": [describe_promotion(promotion) for promotion in made],
        "left_out": dict(plan.left_out),
    }
