"""The log-in of a browser: a key, typed once, is exchanged for a session, whose cookie does not hold it.

The cookie is read by no script, sent by no page of another site (SameSite=Strict) and on no connection without TLS but
to this machine itself, and it ends with the browser. A session opens reads. What changes anything needs, beside it, a
form of one of our own pages: it carries a random word that must equal the one in a cookie of its own.
"""

from __future__ import annotations

import hmac
import re
import secrets
from typing import Annotated
from urllib.parse import parse_qs

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from lbacal_core.errors import BadInputError
from service.errors import ForbiddenError, UnauthenticatedError
from service.handlers.problems import problem_of, wants_page
from service.handlers.request import FORM_COOKIE, SESSION_COOKIE, UseCases, read_form_body, require_caller
from service.page.render import render_page

Form = Annotated[bytes, Depends(read_form_body)]
MOST_FIELDS = 20
LOOPBACK = ("127.0.0.1", "localhost", "::1")
_PATH = re.compile(r"/(?![/\\])[A-Za-z0-9._~/%-]{0,300}(\?[A-Za-z0-9._~/%=&+-]{0,300})?")

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


def install(app: FastAPI) -> None:
    """Show the form in place of a page that needs a key."""

    @app.exception_handler(UnauthenticatedError)
    def _log_in_first(request: Request, error: UnauthenticatedError) -> Response:
        if not wants_page(request):
            return problem_of(error)
        address = request.url.path if request.method == "GET" else "/"
        return show_log_in(request, address, str(error) if SESSION_COOKIE in request.cookies else None)


def show_log_in(request: Request, address: str, problem: str | None, status: int = 401) -> Response:
    """The form in place of a page that needs a key; `address` is where to go afterwards.

    `problem` is a sentence above the form, None where there is nothing to say.
    """
    word = request.cookies.get(FORM_COOKIE) or secrets.token_urlsafe(24)
    page = render_page("log_in.html", here="", instrument="", word=word, address=address, problem=problem)
    shown = HTMLResponse(page, status, {"Cache-Control": "no-store"})
    _set_cookie(request, shown, FORM_COOKIE, word)
    return shown


@router.get("/log-in")
def ask_for_key(request: Request, address: str = "/") -> Response:
    return show_log_in(request, address, None, 200)


@router.post("/log-in")
def log_in(request: Request, use: UseCases, body: Form) -> Response:
    fields = read_form(request, body)
    address, key = fields.get("address", "/"), fields.get("key", "").strip()
    try:
        require_caller(request, use, "read", authorization=f"Bearer {key}")
        session = use.keys.begin_session(key)
    except UnauthenticatedError as error:
        return show_log_in(request, address, str(error))
    answered = RedirectResponse(address if _PATH.fullmatch(address) else "/", 303)
    _set_cookie(request, answered, SESSION_COOKIE, session)
    return answered


@router.post("/log-out")
def log_out(request: Request, use: UseCases, body: Form) -> Response:
    read_form(request, body)
    use.keys.end_session(request.cookies.get(SESSION_COOKIE, ""))
    answered = RedirectResponse("/", 303)
    answered.delete_cookie(SESSION_COOKIE, path="/", httponly=True, samesite="strict")
    return answered


def read_form(request: Request, form: bytes) -> dict[str, str]:
    """The fields, each once, of one of our own forms, sent from one of our own pages."""
    try:
        fields = {name: values[0] for name, values in parse_qs(form.decode(), max_num_fields=MOST_FIELDS).items()}
    except ValueError as error:
        raise BadInputError("body", "a form", "something else") from error
    sent, kept = fields.pop("word", ""), request.cookies.get(FORM_COOKIE, "")
    if not kept or not hmac.compare_digest(sent.encode(), kept.encode()):
        raise ForbiddenError("this form was not sent from a page of this server: load the page again")
    return fields


def _set_cookie(request: Request, response: Response, name: str, value: str) -> None:
    is_here = request.url.hostname in LOOPBACK and request.url.scheme == "http"
    response.set_cookie(name, value, path="/", httponly=True, samesite="strict", secure=not is_here)
