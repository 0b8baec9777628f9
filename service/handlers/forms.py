"""Forms of pages that change something: they ask for a key each time, and keep it nowhere.

The key that a browser keeps opens reads only (`service.handlers.session`). A form here carries a key that its sender
types; no other site knows one, so nothing else tells that it was sent from one of our own pages.
"""

from __future__ import annotations

from typing import Annotated, TypeVar
from urllib.parse import parse_qs

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, RedirectResponse

from lbacal_core.errors import BadInputError
from service.errors import ForbiddenError, UnauthenticatedError
from service.handlers.request import JobNumber, UseCases, read_form_body, require_caller
from service.wire.answers import to_json
from service.wire.bodies import AcknowledgementBody, Body, ReasonBody, parse_body

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)
Form = Annotated[bytes, Depends(read_form_body)]
BodyType = TypeVar("BodyType", bound=Body)
KEY = "key"


@router.post("/cuts/{number}/lift")
def lift_cut(request: Request, use: UseCases, number: JobNumber, form: Form) -> RedirectResponse:
    body, by = _take(request, use, form, ReasonBody, "calibrations:promote")
    use.cuts.lift(number, body, by)
    return RedirectResponse("/drift#cuts", 303)


@router.post("/cuts/{number}/restoration")
def restore_cut(request: Request, use: UseCases, number: JobNumber, form: Form) -> RedirectResponse:
    body, by = _take(request, use, form, ReasonBody, "calibrations:promote")
    use.cuts.restore(number, body, by)
    return RedirectResponse("/drift#cuts", 303)


@router.post("/alarms/{number}/acknowledgement")
def acknowledge_alarm(request: Request, use: UseCases, number: JobNumber, form: Form) -> RedirectResponse:
    body, by = _take(request, use, form, AcknowledgementBody, "refits:run")
    use.alarms.acknowledge(number, body, by)
    return RedirectResponse("/alarms", 303)


def read_fields(form: bytes) -> dict[str, str]:
    """The fields of a form that were filled in, each once."""
    try:
        return {name: values[0] for name, values in parse_qs(form.decode(), max_num_fields=10).items()}
    except ValueError as error:
        raise BadInputError("body", "a form", "something else") from error


def _take(request: Request, use: UseCases, form: bytes, wanted: type[BodyType], scope: str) -> tuple[BodyType, str]:
    """What a form asks for, and the name of the key that was typed into it."""
    fields = read_fields(form)
    try:
        caller = require_caller(request, use, scope, authorization=f"Bearer {fields.pop(KEY, '').strip()}")
    except UnauthenticatedError as error:
        raise ForbiddenError(str(error)) from error  # a page that asks for a log-in would lead nowhere
    return parse_body(wanted, to_json(fields)), caller.name
