"""Errors on the wire: problem details (RFC 9457), one sentence for a human and a stable code for a script."""

from __future__ import annotations

import math
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse
from starlette.exceptions import HTTPException

from lbacal_core.errors import BadInputError, LbacalError
from service.errors import NotAcceptableError, TooManyError, UnavailableError, describe_refusal
from service.page.render import render_page
from service.wire.answers import choose_media, to_json

RETRY_S = 5
STATUSES = {400: "not JSON", 401: "no valid key", 403: "scope missing", 404: "not found", 406: "nothing you accept",
            408: "body too slow", 409: "conflict", 413: "too large", 415: "other content type", 422: "bad input",
            429: "too many requests", 503: "database away or busy"}  # fmt: skip
log = structlog.get_logger()


def problem(status: int, code: str, detail: str, retry_s: float = RETRY_S) -> Response:
    """Describe a problem, the code in its `type`; 429 and 503 say to ask again in `retry_s`."""
    content = {"type": f"urn:lbacal:{code}", "title": HTTPStatus(status).phrase, "status": status, "detail": detail}
    headers = {}
    if status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = "Bearer"
    if status in (HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE):
        headers["Retry-After"] = str(math.ceil(retry_s))
    return Response(to_json(content), status, headers, "application/problem+json")


def problem_of(error: LbacalError) -> Response:
    """Describe an expected failure as a problem."""
    retry_s = error.retry_s if isinstance(error, TooManyError) else RETRY_S
    return problem(error.status, error.code, str(error), retry_s)


def wants_page(request: Request) -> bool:
    """Whether a browser shows the answer to a human."""
    if request.url.path.startswith("/v1/"):
        return False
    offered = {"problem": "application/problem+json", "page": "text/html"}
    try:
        return choose_media(offered, request.headers.get("accept")) == "page"
    except NotAcceptableError:
        return False


def _show(request: Request, answered: Response, detail: str) -> Response:
    """A problem as a page where a human looks at it."""
    if not wants_page(request):
        return answered
    title = HTTPStatus(answered.status_code).phrase
    body = render_page("problem.html", here="", instrument="", title=title, detail=detail)
    kept = {name: answered.headers[name] for name in ("retry-after", "allow") if name in answered.headers}
    return HTMLResponse(body, answered.status_code, kept)


def document(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe the errors of a route for the OpenAPI document: any may have to wait."""
    every = sorted({*statuses, 406, 429, 503, *([408, 413] if 415 in statuses else [])})
    return {s: {"description": STATUSES[s], "content": {"application/problem+json": {}}} for s in every}


def install(app: FastAPI) -> None:
    """Answer every expected failure with a problem; `Edge` answers the others."""

    @app.exception_handler(LbacalError)
    def _expected(request: Request, error: LbacalError) -> Response:
        if isinstance(error, UnavailableError):
            log.warning("unavailable", reason=str(error), detail=error.detail)
        return _show(request, problem_of(error), str(error))

    @app.exception_handler(RequestValidationError)
    def _bad_parameter(request: Request, error: RequestValidationError) -> Response:
        place = ".".join(str(part) for part in error.errors()[0]["loc"][1:]) or "query"
        sentence = str(BadInputError(place, *describe_refusal(error.errors())))
        return _show(request, problem(422, "bad_input", sentence), sentence)

    @app.exception_handler(HTTPException)
    def _no_such_route(request: Request, error: HTTPException) -> Response:
        answered = problem(error.status_code, "no_such_route", f"{request.method} {request.url.path}: {error.detail}")
        answered.headers.update(error.headers or {})
        return _show(request, answered, "there is no such page here")
