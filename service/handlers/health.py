"""Whether the service lives and can serve, and what an operator looks at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Gauge, generate_latest

from lbacal.instants import format_optional
from lbacal_core.curves.validity import Instant
from service.handlers.models import describe_investigation
from service.handlers.problems import document
from service.handlers.request import MAY_READ, UseCases, answer
from service.handlers.routes import reads
from service.storage.alarms import ACKNOWLEDGED, KINDS, OPEN
from service.storage.jobs import Failure
from service.storage.processes import API, SCHEDULER, WORKER
from service.usecases.status import State
from service.wire import answer_models as wire
from service.wire.answers import fill_answer

if TYPE_CHECKING:
    from service.usecases.investigations import StationNews  # with what searches

router = APIRouter(tags=["health"])


@router.get("/healthz", response_model=wire.AliveAnswer, summary="The process lives", responses=document())
async def get_health(request: Request) -> Response:
    return answer(request, {"status": "alive"})


@router.get(
    "/readyz",
    response_model=wire.ReadyAnswer,
    summary="The service can do its work",
    description="503 with the reason while the database is away or of another schema, its disk is full, or no worker "
    "has lived for a minute.",
    responses=document(503),
)
def get_readiness(request: Request, use: UseCases) -> Response:
    use.status.require_ready()
    return answer(request, {"status": "ready", "instrument": use.instrument.name})


@reads(router, "/v1/status", wire.StatusAnswer)
def get_status(request: Request, use: UseCases) -> Response:
    """Show the status of the service.

    Readiness and its problem, processes, parts of jobs, alarms, the newest investigation of every station with what
    the one before did not say, and the failures of the last 30 days that nothing has made up for, with the time
    after which due work is tried again.
    """
    stopped = [one.sentence for one in use.models.stopped()]
    waiting = [cut.warning for one in use.changes.list_all() if not one.is_refitted for cut in one.cuts]
    return answer(request, describe_status(use.status.look(), use.investigations.news(), stopped, waiting))


@router.get(
    "/metrics",
    summary="Counts for Prometheus",
    response_class=PlainTextResponse,
    responses=document(401, 503),
    dependencies=[MAY_READ],
)
def get_metrics(request: Request, use: UseCases) -> Response:
    registry: CollectorRegistry = request.app.state.registry
    text = generate_latest(registry) + generate_latest(describe_state(use.status.look(), use.clock()))
    return answer(request, text, media_type=CONTENT_TYPE_LATEST)


def describe_status(state: State, news: list[StationNews], stopped: list[str], waiting: list[str]) -> dict[str, Any]:
    """Describe the status of the service as JSON values of `StatusAnswer`."""
    processes = [fill_answer(wire.ProcessAnswer, one, silent_s=one.silent_us / 1e6) for one in state.processes]
    newest = [fill_answer(wire.NewsAnswer, one, **describe_investigation(one.newest)) for one in news]
    return fill_answer(
        wire.StatusAnswer, state, ready=state.problem is None, processes=processes,
        alarms=fill_answer(wire.AlarmCountsAnswer, state.alarms), investigations=newest,
        not_refitted=waiting, stopped_paying=stopped, failures=[describe_failure(one) for one in state.failures],
    )  # fmt: skip


def describe_failure(failure: Failure) -> dict[str, Any]:
    """A job that failed as JSON values of `FailureAnswer`.

    It is tried again at `again_after`, null where nobody will unless it is asked for.
    """
    again, failed = (failure.tries.again, failure.tries.failed) if failure.tries else (None, 1)
    error, of_job = "; ".join(failure.job.errors), {"job": failure.job.number, "tries": failed}
    return fill_answer(wire.FailureAnswer, failure.job, error=error, again_after=format_optional(again), **of_job)


def describe_state(state: State, now: Instant) -> CollectorRegistry:
    """The state of the service as gauges."""
    registry = CollectorRegistry()

    def tell(name: str, meaning: str, value: float) -> None:
        Gauge(f"lbacal_{name}", meaning, registry=registry).set(value)

    tell("ready", "1 if the service can do its work.", float(state.problem is None))
    tell("events", "Events stored that are not flagged.", state.events)
    tell("gated_versions", "Versions that the gate kept back and nobody promoted.", state.gated)
    tell("failed_jobs", "Jobs that failed in 30 days and that nothing made up for.", len(state.failures))
    tell("stuck_parts", "Kinds of parts that no worker may begin.", len(state.stuck))
    if state.newest_event is not None:
        tell("newest_event_age_seconds", "Time since the newest event, s.", (now - state.newest_event) / 1e6)
    parts = Gauge("lbacal_parts", "Parts of jobs by state, ended ones of 30 days.", ["state"], registry=registry)
    for name, count in state.parts.items():
        parts.labels(name).set(count)
    alarms = Gauge("lbacal_alarms", "Alarms that last.", ["kind", "state"], registry=registry)
    for kind in KINDS:
        alarms.labels(kind, OPEN).set(state.alarms.open.get(kind, 0))
        alarms.labels(kind, ACKNOWLEDGED).set(state.alarms.acknowledged.get(kind, 0))
    processes = Gauge("lbacal_processes_alive", "Processes seen within a minute.", ["kind"], registry=registry)
    for kind in (API, SCHEDULER, WORKER):
        processes.labels(kind).set(sum(one.is_alive for one in state.processes if one.kind == kind))
    return registry
