"""Investigations of stored spectra: asked for, listed, read."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from service.handlers.problems import document
from service.handlers.request import (
    IMMUTABLE,
    IdempotencyKey,
    InPath,
    JsonBody,
    Limit,
    UseCases,
    answer,
    caller_with,
    describes,
    require_read,
)
from service.storage.models import Investigation
from service.usecases.keys import Caller
from service.wire.answer_models import InvestigationAnswer, InvestigationsAnswer, RefitAnswer
from service.wire.answers import to_json
from service.wire.bodies import InvestigationBody, parse_body
from service.wire.instants import format_instant

router = APIRouter(tags=["investigations"])
Runner = Annotated[Caller, caller_with("refits:run")]


@router.post(
    "/v1/investigations",
    status_code=202,
    response_model=RefitAnswer,
    summary="Ask what the simulation gets wrong in stored spectra",
    description="One report a station and calendar year of the window; the job's `results` are their ids. Inputs that "
    "were investigated before give the report that there is.",
    responses=document(400, 401, 403, 409, 415, 422, 429, 503),
    openapi_extra=describes(InvestigationBody),
)
def request_investigation(
    request: Request, use: UseCases, caller: Runner, body: JsonBody, idempotency_key: IdempotencyKey = None
) -> Response:
    wanted = parse_body(InvestigationBody, body)
    ask = use.investigations.request
    content = use.deeds.once(
        caller.name, idempotency_key, b"investigation" + body, lambda: to_json({"job": ask(wanted, caller.name)})
    )
    return answer(request, content, status=202)


@router.get(
    "/v1/investigations",
    response_model=InvestigationsAnswer,
    summary="List investigations",
    description="Newest first, without their reports; `next` is the cursor of the next page.",
    responses=document(401, 404, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_investigations(
    request: Request,
    use: UseCases,
    station: str | None = None,
    cursor: Annotated[str | None, Query(pattern="^[0-9a-f]{64}$")] = None,
    limit: Limit = 100,
) -> Response:
    found = use.investigations.newest(before=cursor, station=station, limit=limit)
    following = found[-1].id if len(found) == limit else None
    lines = [describe_investigation(one) for one in found]
    return answer(request, {"investigations": lines, "next": following})


@router.get(
    "/v1/investigations/{name}",
    response_model=InvestigationAnswer,
    summary="One investigation, as it was made",
    responses=document(401, 404, 422, 503),
    dependencies=[Depends(require_read)],
)
def get_investigation(request: Request, use: UseCases, name: InPath) -> Response:
    found = use.investigations.get(name)
    content = {**describe_investigation(found), "inputs": found.inputs, "report": found.report}
    return answer(request, content, cache=IMMUTABLE)


def describe_investigation(one: Investigation) -> dict[str, Any]:
    """An investigation without its report, as JSON values."""
    return {
        "id": one.id,
        "station": one.station,
        "since": format_instant(one.since),
        "until": format_instant(one.until),
        "verdict": one.report["verdict"],
        "findings": [finding["cause"] for finding in one.report["findings"]],
        "made_at": format_instant(one.made),
        "made_by": one.made_by,
        "reason": one.reason,
    }
