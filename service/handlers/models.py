"""Models: findings adopted, models listed and withdrawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from lbacal_core.causes.model import AdoptedCause, Model
from service.handlers.calibrations import describe_changes
from service.handlers.problems import document
from service.handlers.request import (
    IMMUTABLE,
    IdempotencyKey,
    InPath,
    JsonBody,
    Limit,
    UseCases,
    Whole,
    answer,
    caller_with,
    describes,
    require_read,
)
from service.storage.models import Gain, Investigation
from service.usecases.keys import Caller
from service.usecases.models import AdoptedModel, Adoption
from service.wire.answer_models import (
    AdoptedCauseAnswer,
    AdoptionAnswer,
    AdoptionPlanAnswer,
    GainAnswer,
    InvestigationAnswer,
    InvestigationLine,
    InvestigationsAnswer,
    ModelLine,
    ModelsAnswer,
    RefitAnswer,
)
from service.wire.answers import fill_answer, to_json
from service.wire.bodies import AdoptionBody, InvestigationBody, ReasonBody, parse_body

router = APIRouter(tags=["models"])
Promoter = Annotated[Caller, caller_with("calibrations:promote")]


@router.post(
    "/v1/investigations/{name}/adoption",
    status_code=202,
    response_model=AdoptionAnswer,
    summary="Adopt a finding into its station's model",
    description="From the investigated window on, until it is withdrawn, fits of the station have the cause. The "
    "windows that it touches are fitted again; `promote` puts those that pass the gate into effect, and it lets a "
    "change of C pass that `dry_run=true` announces. A dry run fits the investigated year, answers 200 and writes "
    "nothing.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503) | {200: {"model": AdoptionPlanAnswer}},
    openapi_extra=describes(AdoptionBody),
)
def adopt_finding(
    request: Request,
    use: UseCases,
    caller: Promoter,
    name: InPath,
    body: JsonBody,
    dry_run: bool = False,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    wanted = parse_body(AdoptionBody, body)
    asked = b"adoption of " + name.encode() + body
    earlier = None if dry_run else use.deeds.recall(caller.name, idempotency_key, asked)
    if earlier is not None:
        return answer(request, earlier, status=202)
    plan = use.models.plan_adoption(name, wanted, caller.name)
    if dry_run:
        return answer(request, describe_plan(plan))

    def adopt() -> bytes:
        return to_json({"model": plan.model.id, "jobs": use.models.adopt(plan, promote=wanted.promote)})

    return answer(request, use.deeds.once(caller.name, idempotency_key, asked, adopt), status=202)


@router.get(
    "/v1/models",
    response_model=ModelsAnswer,
    summary="What stations' models have and had",
    description="Newest first: every adoption and withdrawal, with the causes that the station had from then on and "
    "what each gained on later events; `next` is the cursor of the next page.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
)
def list_models(
    request: Request,
    use: UseCases,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    found = [one for one in use.models.history() if cursor is None or one.change.number < cursor][:limit]
    following = found[-1].change.number if len(found) == limit else None
    return answer(request, {"models": [describe_model(one) for one in found], "next": following})


@router.post(
    "/v1/models/{name}/withdrawal",
    status_code=202,
    response_model=AdoptionAnswer,
    summary="Withdraw a model",
    description="Takes the cause that was adopted with it out of its station's model, puts back at once what was in "
    "effect before, and enqueues refits without the cause.",
    responses=document(400, 401, 403, 404, 409, 415, 422, 503),
    openapi_extra=describes(ReasonBody),
)
def withdraw_model(
    request: Request,
    use: UseCases,
    caller: Promoter,
    name: InPath,
    body: JsonBody,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    wanted = parse_body(ReasonBody, body)

    def withdraw() -> bytes:
        model, jobs = use.models.withdraw(name, wanted, caller.name)
        return to_json({"model": model.id, "jobs": jobs})

    asked = b"withdrawal of model " + name.encode() + body
    return answer(request, use.deeds.once(caller.name, idempotency_key, asked, withdraw), status=202)


def describe_plan(plan: Adoption) -> dict[str, Any]:
    """What an adoption would change, as JSON values."""
    told = {"model": plan.model.id, "cause": plan.cause.sentence, "promise": list(plan.change.promise or ())}
    return {**told, **describe_changes(None, list(plan.changes))}


def describe_model(one: AdoptedModel) -> dict[str, Any]:
    """A line of the ledger of models as JSON values."""
    causes = [describe_cause(cause, one.gains.get(Model((cause,)).id, ())) for cause in one.model.causes]
    return fill_answer(ModelLine, one.change, one, id=one.change.model, changed=one.changed.sentence, causes=causes)


def describe_cause(cause: AdoptedCause, gains: Sequence[Gain]) -> dict[str, Any]:
    """An adopted cause and what it gained, as JSON values."""
    content, gained = cause.as_dict(), [fill_answer(GainAnswer, one, log_likelihood_gain=one.gain) for one in gains]
    named = {name: content[name] for name in ("cause", "target", "parameters", "size", "sigma", "since", "until")}
    return fill_answer(AdoptedCauseAnswer, cause, unit=cause.in_catalogue.unit, gains=gained, **named)


# Investigations of stored spectra: asked for, listed, read.

investigations = APIRouter(tags=["investigations"])
Runner = Annotated[Caller, caller_with("refits:run")]


@investigations.post(
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


@investigations.get(
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


@investigations.get(
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
    findings = [finding["cause"] for finding in one.report["findings"]]
    return fill_answer(InvestigationLine, one, verdict=one.report["verdict"], findings=findings)
