"""Pages behind a log-in: the key travels in a cookie that no script can read, and opens nothing but reads.

A cookie is sent along with whatever another site makes a browser ask for. What changes anything therefore needs the
header `Authorization`, which no other site can make a browser send, or a key typed into a form, and the two forms of
the log-in carry a random word that must equal the one in a cookie of their own.
"""

from __future__ import annotations

import hmac
import re
import secrets
from typing import Annotated, TypeVar
from urllib.parse import parse_qs

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from lbacal_core.errors import BadInputError
from service.errors import ForbiddenError, UnauthenticatedError
from service.handlers.problems import problem_of, wants_page
from service.handlers.request import FORM_COOKIE, KEY_COOKIE, JobNumber, UseCases, read_form_body, require_caller
from service.page.render import render_page
from service.wire.answers import to_json
from service.wire.bodies import AcknowledgementBody, Act, Body, DecisionBody, ReasonBody, parse_body

# Forms of pages that change something: they ask for a key each time, and keep it nowhere.
#
# The key that a browser keeps opens reads only. A form here carries a key that its sender
# types; no other site knows one, so nothing else tells that it was sent from one of our own pages.

forms = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)
Form = Annotated[bytes, Depends(read_form_body)]
BodyType = TypeVar("BodyType", bound=Body)
KEY = "key"


@forms.post("/changes/{number}/{decision}")
def decide_change(request: Request, use: UseCases, number: JobNumber, decision: Act, form: Form) -> RedirectResponse:
    body, by = _take(request, use, form, ReasonBody, "calibrations:promote")
    use.changes.decide(number, DecisionBody(decision=decision, reason=body.reason), by)
    return RedirectResponse("/drift#changes", 303)


@forms.post("/alarms/{number}/acknowledgement")
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


HALF_A_DAY_S = 43_200
_PATH = re.compile(r"/(?![/\\])[A-Za-z0-9._~/%-]{0,300}")

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


def install(app: FastAPI) -> None:
    """Show the form in place of a page that needs a key."""

    @app.exception_handler(UnauthenticatedError)
    def _log_in_first(request: Request, error: UnauthenticatedError) -> Response:
        if not wants_page(request):
            return problem_of(error)
        return show_log_in(request, request.url.path, str(error) if KEY_COOKIE in request.cookies else None)


def show_log_in(request: Request, address: str, problem: str | None) -> Response:
    """The form in place of a page that needs a key; `address` is where to go afterwards."""
    word = request.cookies.get(FORM_COOKIE) or secrets.token_urlsafe(24)
    page = render_page("log_in.html", here="", instrument="", word=word, address=address, problem=problem)
    shown = HTMLResponse(page, 401, {"Cache-Control": "no-store"})
    _set_cookie(request, shown, FORM_COOKIE, word)
    return shown


@router.post("/log-in")
def log_in(request: Request, use: UseCases, body: Form) -> Response:
    fields = _read_form(request, body)
    address = fields.get("address", "/")
    address = address if _PATH.fullmatch(address) else "/"
    key = fields.get("key", "").strip()
    try:
        require_caller(request, use, "read", authorization=f"Bearer {key}")
    except UnauthenticatedError as error:
        return show_log_in(request, address, str(error))
    answered = RedirectResponse(address, 303)
    _set_cookie(request, answered, KEY_COOKIE, key)
    return answered


@router.post("/log-out")
def log_out(request: Request, body: Form) -> Response:
    _read_form(request, body)
    answered = RedirectResponse("/", 303)
    answered.delete_cookie(KEY_COOKIE, path="/", httponly=True, samesite="lax")
    return answered


def _read_form(request: Request, body: bytes) -> dict[str, str]:
    """The fields of one of our own forms, sent from one of our own pages."""
    fields = read_fields(body)
    sent, kept = fields.get("word", ""), request.cookies.get(FORM_COOKIE, "")
    if not kept or not hmac.compare_digest(sent.encode(), kept.encode()):
        raise ForbiddenError("this form was not sent from a page of this server: load the page again")
    return fields


def _set_cookie(request: Request, response: Response, name: str, value: str) -> None:
    is_encrypted = request.url.scheme == "https"
    response.set_cookie(name, value, max_age=HALF_A_DAY_S, path="/", httponly=True, samesite="lax", secure=is_encrypted)
