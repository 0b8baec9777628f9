"""Refits on demand, and how far they are."""

from __future__ import annotations

from operator import attrgetter
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from lbacal.instants import format_instant
from service.handlers.ledger import PROMOTE
from service.handlers.request import (
    JobNumber,
    Limit,
    OptionalJsonBody,
    UseCases,
    Whole,
    answer,
    caller_with,
    require_caller,
)
from service.handlers.routes import Order, acts, ordered, page_of, reads
from service.storage.jobs import Job
from service.usecases.keys import Caller
from service.usecases.orders import stop_job
from service.wire.answer_models import JobAnswer, JobsAnswer, RefitAnswer
from service.wire.answers import fill_answer
from service.wire.bodies import ReasonBody, RefitBody, parse_body

router = APIRouter(tags=["jobs"])
RUN = "refits:run"


@acts(router, "/v1/refits", RefitBody, RefitAnswer, 409, status=202)
def request_refit(
    request: Request, use: UseCases, order: Annotated[Order[RefitBody], ordered(RefitBody, RUN)]
) -> Response:
    """Ask for new fits.

    One window, one fit a version. `promote` puts those that pass the gate into effect for the window and also needs
    the scope `calibrations:promote`.
    """
    if order.wanted.promote:
        require_caller(request, use, PROMOTE)
    done = order.once("refit", lambda: {"job": use.refits.request(order.wanted, order.caller)})
    return answer(request, done, status=202)


@reads(router, "/v1/jobs", JobsAnswer)
def list_jobs(
    request: Request,
    use: UseCases,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    """List jobs.

    Newest first; `next` is the cursor of the next page.
    """
    jobs = use.database.look(lambda stores: stores.jobs.newest(before=cursor, limit=limit))
    return answer(request, page_of("jobs", jobs, limit, describe_job, attrgetter("number")))


@reads(router, "/v1/jobs/{number}", JobAnswer, 404)
def get_job(request: Request, use: UseCases, number: JobNumber) -> Response:
    """Get one job."""
    return answer(request, describe_job(use.database.look(lambda stores: stores.jobs.get(number))))


@acts(router, "/v1/jobs/{number}/cancel", ReasonBody, JobAnswer, 404, 409, status=200, is_body_required=False)
def cancel_job(
    request: Request, use: UseCases, caller: Annotated[Caller, caller_with(RUN)], number: JobNumber,
    body: OptionalJsonBody,
) -> Response:  # fmt: skip
    """Stop a job.

    What it has stored stays; who stopped it and why (`reason`, which may be left out) is kept. A job that has ended
    cannot be stopped (409). Due work that was stopped is tried again after a day.
    """
    reason = parse_body(ReasonBody, body).reason if body else None
    return answer(request, describe_job(stop_job(use.database, use.clock(), number, caller.name, reason)))


def describe_job(job: Job) -> dict[str, Any]:
    """Describe a job as JSON values of `JobAnswer`."""
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
