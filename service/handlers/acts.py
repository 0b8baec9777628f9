"""What an admin does on a page: a form leads to what it would change, and from there a second one does it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from lbacal.instants import format_instant
from lbacal_core.errors import BadInputError, name_path, write_count
from service.errors import ConflictError, NotFoundError, UnauthenticatedError
from service.factory import Factory
from service.handlers.jobs import RUN, describe_job
from service.handlers.ledger import PROMOTE, TAG_NAME
from service.handlers.request import FORM_COOKIE, SESSION_COOKIE, InPath, UseCases, require_caller
from service.handlers.session import Form, read_form
from service.page.render import render_page
from service.storage.jobs import Job
from service.usecases.orders import stop_job
from service.usecases.promotions import Change, Plan
from service.wire import bodies
from service.wire.answers import to_json

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)
NUMBERS, SWITCHES = ("antenna", "finding"), ("promote",)


@dataclass(frozen=True)
class Foreseen:
    """A forecast of an act: sentences, the function that does it, and changes of C."""

    sentences: Sequence[str]
    do: Callable[[], object]
    changes: Sequence[Change] = ()


@dataclass(frozen=True)
class Act:
    """One kind of act: its title, who may, its form, what it would do to `target`, and the page that is shown then."""

    title: str
    scope: str
    body: type[bodies.Body]
    foresee: Callable[[Factory, str, Any, str], Foreseen]
    then: str


@router.post("/acts/{name}")
def act(request: Request, use: UseCases, name: InPath, form: Form) -> Response:
    if name not in ACTS:
        raise NotFoundError(f"no act {name}: there are {', '.join(ACTS)}")
    fields, wanted = read_form(request, form), ACTS[name]
    session = request.cookies.get(SESSION_COOKIE)
    if session is None:
        raise UnauthenticatedError(f"this needs a key with scope {wanted.scope}")
    scopes = [wanted.scope, *([PROMOTE] if "promote" in fields else [])]
    caller = require_caller(request, use, *scopes, session=session)
    is_sure, target, back = fields.pop("sure", "") == "yes", fields.pop("target", ""), fields.pop("back", "/")
    body = bodies.parse_body(wanted.body, to_json({field: _read(field, text) for field, text in fields.items()}))
    found = wanted.foresee(use, target, body, caller.name)
    if is_sure:
        found.do()
        return RedirectResponse(wanted.then.format(**fields), 303)
    word, told = request.cookies[FORM_COOKIE], {"here": "", "instrument": use.instrument.name}
    kept = {**fields, "target": target, "back": back}
    page = render_page(
        "act.html", **told, leave=word, title=wanted.title, act=name, found=found, kept=kept, back=_own(back)
    )
    return HTMLResponse(page, headers={"Cache-Control": "no-store"})


def _read(field: str, text: str) -> Any:
    if field in NUMBERS and text.isascii() and text.isdigit() and len(text) < 10:
        return int(text)
    return True if field in SWITCHES else text


def _own(address: str) -> str:
    return address if address.startswith("/") and not address.startswith(("//", "/\\")) else "/"


def _number(target: str) -> int:
    if not (target.isascii() and target.isdigit() and len(target) < 19):
        raise BadInputError("target", "a number", repr(target[:60]))
    return int(target)


def _decide(use: Factory, target: str, body: bodies.DecisionBody, by: str) -> Foreseen:
    number = _number(target)
    kept, changes, left_out = use.changes.foresee(number, body, by)
    one, verb = kept.change, "is in force" if body.decision == "in_force" else "is dismissed"
    whose = f"{name_path(one.station)}{' antenna ' + ', '.join(map(str, one.antennas)) if one.antennas else ''}"
    sentence = f"Change {number} of {whose} on {format_instant(one.date)[:10]} {verb}; the next night refits."
    told = [sentence, *_tell_left_out(left_out)]
    return Foreseen(told, lambda: use.changes.decide(number, body, by), changes)


def _acknowledge(use: Factory, target: str, body: bodies.AcknowledgementBody, by: str) -> Foreseen:
    number, until = _number(target), f"until {body.until}" if body.until else "for good"
    sentence = f"Alarm {number} counts as known {until}; nothing else changes."
    return Foreseen([sentence], lambda: use.alarms.acknowledge(number, body, by))


def _promote(use: Factory, _target: str, body: bodies.PromotionBody, by: str) -> Foreseen:
    return _of_plan(use, use.promotions.plan(body, by))


def _roll_back(use: Factory, target: str, body: bodies.ReasonBody, by: str) -> Foreseen:
    return _of_plan(use, use.promotions.plan_rollback(_number(target), body, by))


def _of_plan(use: Factory, plan: Plan) -> Foreseen:
    promoted = f"{write_count(len(plan.wanted), 'promotion')} to write into the ledger, undone by rolling back."
    told = [promoted, *_tell_left_out(plan.left_out)]
    return Foreseen(told, lambda: use.promotions.promote(plan, lambda *_: None), plan.changes)


def _tell_left_out(left_out: Mapping[str, str]) -> list[str]:
    return [f"{name}: left out, {why}" for name, why in left_out.items()]


def _tag(use: Factory, target: str, body: bodies.TagBody, by: str) -> Foreseen:
    if TAG_NAME.fullmatch(target) is None:
        raise BadInputError("target", "letters, digits, dot, dash and underscore", repr(target[:80]))
    sentence = f"The tag {target} names what the ledger says {body.as_of or 'now'}, for good."
    return Foreseen([sentence], lambda: use.tags.put(target, body, by))


def _adopt(use: Factory, target: str, body: bodies.AdoptionBody, by: str) -> Foreseen:
    plan = use.models.plan_adoption(target, body, by)
    sentences = [plan.cause.sentence, "Fits of the station have this cause until it is withdrawn."]
    return Foreseen(sentences, lambda: use.models.adopt(plan, promote=body.promote), plan.changes)


def _withdraw(use: Factory, target: str, body: bodies.ReasonBody, by: str) -> Foreseen:
    back = "What was in effect before its adoption answers again at once, and refits without the cause are enqueued."
    return Foreseen([back], lambda: use.models.withdraw(target, body, by))


def _refit(use: Factory, _target: str, body: bodies.RefitBody, by: str) -> Foreseen:
    whose = name_path(body.station, body.antenna, body.dipole)
    then = "what passes the gate is put in effect" if body.promote else "nothing is put in effect by itself"
    sentence = f"Scope {body.scope} of {whose} is fitted over {body.since} to {body.until}; {then}."
    return Foreseen([sentence], lambda: use.refits.request(body, by))


def _investigate(use: Factory, _target: str, body: bodies.InvestigationBody, by: str) -> Foreseen:
    sentence = f"{body.station or 'Every station'} is searched over {body.since} to {body.until}."
    return Foreseen([sentence], lambda: use.investigations.request(body, by))


def _get_job(use: Factory, target: str) -> Job:
    return use.database.look(lambda stores: stores.jobs.get(_number(target)))


def _cancel(use: Factory, target: str, body: bodies.ReasonBody, by: str) -> Foreseen:
    job = _get_job(use, target)
    sentence = f"Job {job.number} ({job.kind}, {job.state}) stops; what it has stored stays."
    return Foreseen([sentence], lambda: stop_job(use.database, use.clock(), job.number, by, body.reason))


def _retry(use: Factory, target: str, body: bodies.ReasonBody, by: str) -> Foreseen:
    job = _get_job(use, target)
    if job.kind == "refit":
        return _refit(use, target, _again(job, bodies.RefitBody, body.reason), by)
    if job.kind == "investigation":
        return _investigate(use, target, _again(job, bodies.InvestigationBody, body.reason), by)
    raise ConflictError(f"job {job.number} is work of the night ({job.kind}), which tries it again by itself")


def _again(job: Job, kind: type[bodies.AnyBody], reason: str) -> bodies.AnyBody:
    """The request of a job once more."""
    known = {name: one for name, one in describe_job(job)["request"].items() if name in kind.model_fields}
    return bodies.parse_body(kind, to_json({**known, "reason": reason}))


ACTS: Mapping[str, Act] = {
    "decide": Act("Decide about a change", PROMOTE, bodies.DecisionBody, _decide, "/drift#changes"),
    "acknowledge": Act("Acknowledge an alarm", RUN, bodies.AcknowledgementBody, _acknowledge, "/alarms"),
    "promote": Act("Put a version in effect", PROMOTE, bodies.PromotionBody, _promote, "/calibrations/{calibration}"),
    "roll-back": Act("Roll a promotion back", PROMOTE, bodies.ReasonBody, _roll_back, "/"),
    "tag": Act("Freeze the ledger under a tag", PROMOTE, bodies.TagBody, _tag, "/"),
    "adopt": Act("Adopt a finding into the model", PROMOTE, bodies.AdoptionBody, _adopt, "/models"),
    "withdraw": Act("Withdraw an adopted cause", PROMOTE, bodies.ReasonBody, _withdraw, "/models"),
    "refit": Act("Ask for new fits", RUN, bodies.RefitBody, _refit, "/jobs"),
    "investigate": Act("Ask what the simulation gets wrong", RUN, bodies.InvestigationBody, _investigate, "/jobs"),
    "cancel": Act("Stop a job", RUN, bodies.ReasonBody, _cancel, "/jobs"),
    "retry": Act("Try a job again", RUN, bodies.ReasonBody, _retry, "/jobs"),
}
