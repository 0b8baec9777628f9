"""Alarms: what is wrong and lasts, and who knows of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request, Response

from lbacal_core.curves.validity import Instant
from service.handlers.problems import document
from service.handlers.request import (
    JobNumber,
    JsonBody,
    Limit,
    UseCases,
    Whole,
    answer,
    caller_with,
    describes,
    require_read,
)
from service.storage.alarms import ACKNOWLEDGED, OPEN, STATES, Acknowledgement, Alarm
from service.usecases.keys import Caller
from service.wire.answer_models import AlarmAnswer, AlarmKind, AlarmsAnswer
from service.wire.answers import describe_scope
from service.wire.bodies import AcknowledgementBody, parse_body
from service.wire.instants import DAY_US, format_instant, format_optional

router = APIRouter(tags=["alarms"])
Operator = Annotated[Caller, caller_with("refits:run")]
State = Literal["open", "acknowledged", "ended", "lasting", "all"]
CHOICES = {"lasting": (OPEN, ACKNOWLEDGED), "all": STATES}


@router.get(
    "/v1/alarms",
    response_model=AlarmsAnswer,
    summary="What is wrong",
    description="Newest first. `state`: `open` are those that nobody acknowledged, or whose acknowledgement has run "
    "out; `lasting` (the default) are these and the acknowledged ones; `ended` are over. A problem is one alarm from "
    "the night on which it was found. `next` is the cursor of the next page.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_alarms(
    request: Request,
    use: UseCases,
    state: State = "lasting",
    kind: AlarmKind | None = None,
    station: str | None = None,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    states = CHOICES.get(state, (state,))
    found = use.alarms.newest(states=states, kind=kind, station=station, before=cursor, limit=limit)
    following = found[-1].number if len(found) == limit else None
    return answer(request, {"alarms": [describe_alarm(one, use.clock()) for one in found], "next": following})


@router.post(
    "/v1/alarms/{number}/acknowledgement",
    status_code=201,
    response_model=AlarmAnswer,
    summary="Say that a problem is known",
    description="It is not told again, until `until` where that is given: then it is open again if it still lasts. "
    "The last acknowledgement counts.",
    responses=document(400, 401, 403, 404, 415, 422, 503),
    openapi_extra=describes(AcknowledgementBody),
)
def acknowledge_alarm(request: Request, use: UseCases, number: JobNumber, caller: Operator, body: JsonBody) -> Response:
    known = use.alarms.acknowledge(number, parse_body(AcknowledgementBody, body), caller.name)
    return answer(request, describe_alarm(known, use.clock()), status=201)


def describe_alarm(alarm: Alarm, now: Instant) -> dict[str, Any]:
    """An alarm as JSON values."""
    news, known = alarm.news, alarm.acknowledgement
    return {
        "alarm": alarm.number,
        "kind": news.kind,
        "state": alarm.state_at(now),
        "scope": news.scope.level,
        **describe_scope(news.scope),
        "sentence": news.sentence,
        "since": format_optional(news.since),
        "since_sigma_days": None if news.since is None else news.since_error_us / DAY_US,
        "raised_at": format_instant(alarm.raised),
        "seen_at": format_instant(alarm.seen),
        "ended_at": format_optional(alarm.ended),
        "acknowledgement": None if known is None else describe_acknowledgement(known),
        "content": dict(news.content),
    }


def describe_acknowledgement(known: Acknowledgement) -> dict[str, Any]:
    """Who knows of a problem, as JSON values."""
    return {
        "by": known.by,
        "at": format_instant(known.at),
        "reason": known.reason,
        "until": format_optional(known.until),
    }
