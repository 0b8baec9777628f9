"""Models: findings adopted, models listed and withdrawn."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from lbacal_core.causes.model import AdoptedCause
from service.handlers.jobs import RUN
from service.handlers.ledger import PROMOTE, Reasoned, describe_changes
from service.handlers.request import IMMUTABLE, InPath, Limit, StationQuery, UseCases, Whole, answer
from service.handlers.routes import Order, acts, ordered, page_of, reads
from service.storage.models import Gain, Investigation
from service.usecases.models import AdoptedModel
from service.wire import answer_models as wire
from service.wire.answers import fill_answer
from service.wire.bodies import AdoptionBody, InvestigationBody, ReasonBody

router = APIRouter(tags=["models"])


@acts(
    router, "/v1/investigations/{name}/adoption", AdoptionBody, wire.AdoptionAnswer, 404, 409, status=202,
    otherwise=wire.AdoptionPlanAnswer,
)  # fmt: skip
def adopt_finding(
    request: Request,
    use: UseCases,
    order: Annotated[Order[AdoptionBody], ordered(AdoptionBody, PROMOTE)],
    name: InPath,
    dry_run: bool = False,
) -> Response:
    """Adopt a finding into its station's model.

    From the investigated window on, until it is withdrawn, fits of the station have the cause. The windows that it
    touches are fitted again; `promote` puts those that pass the gate into effect, and it lets a change of C pass
    that `dry_run=true` announces. A dry run fits the investigated year, answers 200 and writes nothing.
    """
    what = f"adoption of {name}"
    earlier = None if dry_run else order.recall(what)
    if earlier is not None:
        return answer(request, earlier, status=202)
    plan = use.models.plan_adoption(name, order.wanted, order.caller)
    if dry_run:
        told = {"model": plan.model.id, "cause": plan.cause.sentence, "promise": list(plan.change.promise or ())}
        return answer(request, {**told, "changes": describe_changes(plan.changes)})

    def adopt() -> dict[str, Any]:
        return {"model": plan.model.id, "jobs": use.models.adopt(plan, promote=order.wanted.promote)}

    return answer(request, order.once(what, adopt), status=202)


@reads(router, "/v1/models", wire.ModelsAnswer)
def list_models(
    request: Request,
    use: UseCases,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    """List the models of stations, present and past.

    Newest first: every adoption and withdrawal, with the causes that the station had from then on and what each
    gained on later events; `next` is the cursor of the next page.
    """
    found = [one for one in use.models.history() if cursor is None or one.change.number < cursor][:limit]
    return answer(request, page_of("models", found, limit, describe_model, attrgetter("change.number")))


@acts(router, "/v1/models/{name}/withdrawal", ReasonBody, wire.AdoptionAnswer, 404, 409, status=202)
def withdraw_model(request: Request, use: UseCases, order: Reasoned, name: InPath) -> Response:
    """Withdraw a model.

    Takes the cause that was adopted with it out of its station's model, puts back at once what was in effect
    before, and enqueues refits without the cause.
    """

    def withdraw() -> dict[str, Any]:
        model, jobs = use.models.withdraw(name, order.wanted, order.caller)
        return {"model": model.id, "jobs": jobs}

    return answer(request, order.once(f"withdrawal of model {name}", withdraw), status=202)


def describe_model(one: AdoptedModel) -> dict[str, Any]:
    """A line of the ledger of models as JSON values of `ModelLine`."""
    causes = [describe_cause(cause, one.gains.get(name, ())) for name, cause in one.model.by_id.items()]
    return fill_answer(
        wire.ModelLine, one.change, one, id=one.change.model, changed=one.changed.sentence, causes=causes
    )


def describe_cause(cause: AdoptedCause, gains: Sequence[Gain]) -> dict[str, Any]:
    """An adopted cause as JSON values of `AdoptedCauseAnswer`, with what it gained as `gains`."""
    content = cause.as_dict()
    gained = [fill_answer(wire.GainAnswer, one, log_likelihood_gain=one.gain) for one in gains]
    named = {name: content[name] for name in ("cause", "target", "parameters", "size", "sigma", "since", "until")}
    return fill_answer(wire.AdoptedCauseAnswer, cause, unit=cause.in_catalogue.unit, gains=gained, **named)


# Investigations of stored spectra: asked for, listed, read.

investigations = APIRouter(tags=["investigations"])


@acts(investigations, "/v1/investigations", InvestigationBody, wire.RefitAnswer, 409, 429, status=202)
def request_investigation(
    request: Request, use: UseCases, order: Annotated[Order[InvestigationBody], ordered(InvestigationBody, RUN)]
) -> Response:
    """Ask what the simulation gets wrong in stored spectra.

    One report a station and calendar year of the window; the job's `results` are their ids. Inputs that were
    investigated before give the report that there is.
    """
    done = order.once("investigation", lambda: {"job": use.investigations.request(order.wanted, order.caller)})
    return answer(request, done, status=202)


@reads(investigations, "/v1/investigations", wire.InvestigationsAnswer, 404)
def list_investigations(
    request: Request,
    use: UseCases,
    station: StationQuery,
    cursor: Annotated[str | None, Query(pattern="^[0-9a-f]{64}$")] = None,
    limit: Limit = 100,
) -> Response:
    """List investigations.

    Newest first, without their reports; `next` is the cursor of the next page.
    """
    found = use.database.look(lambda stores: stores.investigations.newest(before=cursor, station=station, limit=limit))
    return answer(request, page_of("investigations", found, limit, describe_investigation, attrgetter("id")))


@reads(investigations, "/v1/investigations/{name}", wire.InvestigationAnswer, 404)
def get_investigation(request: Request, use: UseCases, name: InPath) -> Response:
    """Get one investigation, as it was made."""
    found = use.database.look(lambda stores: stores.investigations.get(name))
    content = {**describe_investigation(found), "inputs": found.inputs, "report": found.report}
    return answer(request, content, cache=IMMUTABLE)


def describe_investigation(one: Investigation) -> dict[str, Any]:
    """An investigation without its report, as JSON values of `InvestigationLine`."""
    findings = [finding["cause"] for finding in one.report["findings"]]
    return fill_answer(wire.InvestigationLine, one, verdict=one.report["verdict"], findings=findings)
