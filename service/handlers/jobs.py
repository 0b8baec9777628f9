"""Refits on demand, and how far they are."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from lbacal.instants import format_instant
from service.handlers.problems import document
from service.handlers.request import (
    IdempotencyKey,
    JobNumber,
    JsonBody,
    Limit,
    OptionalJsonBody,
    UseCases,
    Whole,
    answer,
    caller_with,
    describes,
    require_caller,
    require_read,
)
from service.storage.jobs import Job
from service.usecases.keys import Caller
from service.wire.answer_models import JobAnswer, JobsAnswer, RefitAnswer
from service.wire.answers import fill_answer, to_json
from service.wire.bodies import ReasonBody, RefitBody, parse_body

router = APIRouter(tags=["jobs"])
Runner = Annotated[Caller, caller_with("refits:run")]


@router.post(
    "/v1/refits",
    status_code=202,
    response_model=RefitAnswer,
    summary="Ask for new fits",
    description="One window, one fit a version. `promote` puts those that pass the gate into effect for the window and "
    "also needs the scope `calibrations:promote`.",
    responses=document(400, 401, 403, 409, 415, 422, 503),
    openapi_extra=describes(RefitBody),
)
def request_refit(
    request: Request, use: UseCases, caller: Runner, body: JsonBody, idempotency_key: IdempotencyKey = None
) -> Response:
    wanted = parse_body(RefitBody, body)
    if wanted.promote:
        require_caller(request, use, "calibrations:promote")
    content = use.deeds.once(
        caller.name, idempotency_key, b"refit" + body, lambda: to_json({"job": use.refits.request(wanted, caller.name)})
    )
    return answer(request, content, status=202)


@router.get(
    "/v1/jobs",
    response_model=JobsAnswer,
    summary="List jobs",
    description="Newest first; `next` is the cursor of the next page.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_jobs(
    request: Request,
    use: UseCases,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    jobs = use.jobs.newest(before=cursor, limit=limit)
    following = jobs[-1].number if len(jobs) == limit else None
    return answer(request, {"jobs": [describe_job(job) for job in jobs], "next": following})


@router.get(
    "/v1/jobs/{number}",
    response_model=JobAnswer,
    summary="One job",
    responses=document(401, 404, 422, 503),
    dependencies=[Depends(require_read)],
)
def get_job(request: Request, use: UseCases, number: JobNumber) -> Response:
    return answer(request, describe_job(use.jobs.get(number)))


@router.post(
    "/v1/jobs/{number}/cancel",
    response_model=JobAnswer,
    summary="Stop a job",
    description="What it has stored stays; who stopped it and why (`reason`, which may be left out) is kept. A job "
    "that has ended cannot be stopped (409). Due work that was stopped is tried again after a day.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503),
    openapi_extra=describes(ReasonBody, required=False),
)
def cancel_job(request: Request, use: UseCases, caller: Runner, number: JobNumber, body: OptionalJsonBody) -> Response:
    reason = parse_body(ReasonBody, body).reason if body else None
    return answer(request, describe_job(use.jobs.cancel(number, caller.name, reason)))


def describe_job(job: Job) -> dict[str, Any]:
    """A job as JSON values."""
    listed = {
        name: [one for result in job.results for one in result.get(name, [])]
        for name in ("calibrations", "promoted", "results")
    }
    return fill_answer(
        JobAnswer, job, job=job.number, **listed,
        gated={name: why for result in job.results for name, why in result.get("gated", {}).items()},
        examined=sum(result.get("examined", 0) for result in job.results),
        error="; ".join(job.errors) or None,
        request={name: _on_the_wire(name, value) for name, value in job.request.items()},
    )  # fmt: skip


def _on_the_wire(name: str, value: Any) -> Any:
    """A field of a request; the scheduler writes instants as numbers."""
    return format_instant(value) if name in ("since", "until") and isinstance(value, int) else value
