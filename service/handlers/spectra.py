"""Spectra in, and what is stored."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from lbacal.instants import format_instant, parse_instant
from service.handlers.problems import document
from service.handlers.request import (
    HDF5,
    InPath,
    JsonBody,
    Limit,
    SpectraUpload,
    UseCases,
    Whole,
    answer,
    caller_with,
    describes,
    media_type_of,
    require_read,
)
from service.storage.spectra import StoredEvent
from service.usecases.keys import Caller
from service.wire.answer_models import EventAnswer, EventsAnswer, ReceiptAnswer, ReceiptsAnswer
from service.wire.answers import fill_answer
from service.wire.bodies import FlagBody, SpectraBody, parse_body

router = APIRouter(tags=["spectra"])
Writer = Annotated[Caller, caller_with("spectra:write")]


@router.post(
    "/v1/spectra",
    status_code=201,
    response_model=ReceiptAnswer,
    summary="Store spectra",
    description="A whole batch or nothing, as JSON or as a spectra file (HDF5); sending the same again does no harm. "
    "201 if anything was stored, else 200.",
    responses={
        200: {"description": "all of them were there", "model": ReceiptAnswer},
        **document(400, 401, 403, 409, 415, 422, 503),
    },
    openapi_extra=describes(SpectraBody, HDF5),
)
def store_spectra(request: Request, use: UseCases, _caller: Writer, body: SpectraUpload) -> Response:
    receipt = use.intake.receive(body, is_file=media_type_of(request) == HDF5)
    content = {"received": receipt.received, "stored": receipt.stored, "duplicates": receipt.duplicates}
    return answer(request, content, status=201 if receipt.stored else 200)


@router.get(
    "/v1/spectra/receipts",
    response_model=ReceiptsAnswer,
    summary="Which bodies are stored already",
    description="Of the bodies named by the SHA-256 of their bytes, those whose spectra are all stored: they need not "
    "be sent again.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_receipts(
    request: Request,
    use: UseCases,
    sha256: Annotated[str, Query(pattern=r"^[0-9a-f]{64}(,[0-9a-f]{64}){0,99}$", description="up to 100, with commas")],
) -> Response:
    return answer(request, {"stored": sorted(use.intake.find_receipts(sha256.split(",")))})


@router.get(
    "/v1/events",
    response_model=EventsAnswer,
    summary="List stored events",
    description="In order of arrival, with the count of their spectra; `next` is the cursor of the next page.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_events(
    request: Request,
    use: UseCases,
    station: Annotated[str | None, Query(pattern=r"^[^\x00-\x1f]{1,200}$")] = None,
    since: str | None = None,
    until: str | None = None,
    flag: Annotated[str | None, Query(pattern=r"^[^\x00-\x1f]{1,200}$")] = None,
    cursor: Annotated[Whole, Query(ge=0, le=2**63 - 1)] = 0,
    limit: Limit = 100,
) -> Response:
    events = use.intake.events(
        station=station,
        since=None if since is None else parse_instant("since", since),
        until=None if until is None else parse_instant("until", until),
        flag=flag,
        cursor=cursor,
        limit=limit,
    )
    following = events[-1].number if len(events) == limit else None
    return answer(request, {"events": [describe_event(event) for event in events], "next": following})


@router.post(
    "/v1/events/{event_id}/flag",
    response_model=EventAnswer,
    summary="Set or clear the quality flag of an event",
    description="A flagged event is left out of fits; null clears. Who did it and why is kept.",
    responses=document(400, 401, 403, 404, 415, 422, 503),
    openapi_extra=describes(FlagBody),
)
def flag_event(request: Request, use: UseCases, caller: Writer, event_id: InPath, body: JsonBody) -> Response:
    wanted = parse_body(FlagBody, body)
    event = use.intake.set_flag(event_id, wanted.flag, reason=wanted.reason, by=caller.name)
    return answer(request, describe_event(event))


def describe_event(event: StoredEvent) -> dict[str, Any]:
    """An event as JSON values."""
    return fill_answer(EventAnswer, event, time_utc=format_instant(event.time))
