"""Cuts: dates at which the watch cuts the windows of antennas, and what people decide about them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response

from service.handlers.problems import document
from service.handlers.request import JobNumber, JsonBody, UseCases, answer, caller_with, describes, require_read
from service.storage.drift import KeptCut
from service.usecases.keys import Caller
from service.wire.answer_models import CutAnswer, CutsAnswer
from service.wire.bodies import ReasonBody, parse_body
from service.wire.instants import format_instant, format_optional

router = APIRouter(tags=["cuts"])
Promoter = Annotated[Caller, caller_with("calibrations:promote")]


@router.get(
    "/v1/cuts",
    response_model=CutsAnswer,
    summary="Where windows are cut",
    description="Dates at which the watch found that an antenna changed, in order of antenna and date: the windows of "
    "its refits are cut there while the cut stands.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_cuts(request: Request, use: UseCases, station: str | None = None) -> Response:
    return answer(request, {"cuts": [describe_cut(one) for one in use.cuts.list_all(station)]})


@router.post(
    "/v1/cuts/{number}/lift",
    status_code=201,
    response_model=CutAnswer,
    summary="Leave windows whole at a date",
    description="Although the watch finds a change there; the next look for due work fits the windows again. A cut "
    "that is lifted already, or that has ended, is 409.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503),
    openapi_extra=describes(ReasonBody),
)
def lift_cut(request: Request, use: UseCases, number: JobNumber, caller: Promoter, body: JsonBody) -> Response:
    lifted = use.cuts.lift(number, parse_body(ReasonBody, body), caller.name)
    return answer(request, describe_cut(lifted), status=201)


@router.post(
    "/v1/cuts/{number}/restoration",
    status_code=201,
    response_model=CutAnswer,
    summary="Cut windows again where the cut was lifted",
    description="The next look for due work fits the windows again. A cut that stands, or that has ended, is 409.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503),
    openapi_extra=describes(ReasonBody),
)
def restore_cut(request: Request, use: UseCases, number: JobNumber, caller: Promoter, body: JsonBody) -> Response:
    restored = use.cuts.restore(number, parse_body(ReasonBody, body), caller.name)
    return answer(request, describe_cut(restored), status=201)


def describe_cut(kept: KeptCut) -> dict[str, Any]:
    """A cut as JSON values."""
    cut, decision = kept.cut, kept.decision
    said = None if decision is None else {**vars(decision), "at": format_instant(decision.at)}
    return {
        "cut": kept.number,
        "station": cut.station,
        "antenna": cut.antenna,
        "date": format_instant(cut.date),
        "date_sigma_days": cut.sigma_days,
        "stands": kept.stands,
        "refitted": kept.is_refitted,
        "made_at": format_instant(kept.made),
        "ended_at": format_optional(kept.ended),
        "decision": said,
    }
