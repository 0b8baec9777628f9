"""Errors on the wire: problem details (RFC 9457), one sentence for a human and a stable code for a script."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from lbacal_core.errors import LbacalError
from service.wire.answers import to_json

RETRY_S = "5"
STATUSES = {400: "not JSON", 401: "no valid key", 403: "scope missing", 404: "not found", 409: "conflict",
            413: "too large", 415: "other content type", 422: "bad input", 503: "database away"}  # fmt: skip


def problem(status: int, code: str, detail: str) -> Response:
    """One problem."""
    content = {"type": f"urn:lbacal:{code}", "title": HTTPStatus(status).phrase, "status": status, "detail": detail}
    headers = {}
    if status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = "Bearer"
    if status in (HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE):
        headers["Retry-After"] = RETRY_S
    return Response(to_json(content), status, headers, "application/problem+json")


def document(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """What a route's errors look like, for the OpenAPI document."""
    return {s: {"description": STATUSES[s], "content": {"application/problem+json": {}}} for s in statuses}


def install(app: FastAPI) -> None:
    """Answer every failure with a problem."""

    @app.exception_handler(LbacalError)
    def _expected(_request: Request, error: LbacalError) -> Response:
        return problem(error.status, error.code, str(error))

    @app.exception_handler(RequestValidationError)
    def _bad_parameter(_request: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"][1:]) or "query"
        return problem(422, "bad_input", f"{place}: {first['msg'].lower()}, found {str(first.get('input'))[:60]!r}")

    @app.exception_handler(HTTPException)
    def _no_such_route(request: Request, error: HTTPException) -> Response:
        answered = problem(error.status_code, "no_such_route", f"{request.method} {request.url.path}: {error.detail}")
        answered.headers.update(error.headers or {})
        return answered

    @app.exception_handler(Exception)
    def _unexpected(request: Request, error: Exception) -> Response:
        structlog.get_logger().error("unexpected failure", path=request.url.path, exc_info=error)
        return problem(500, "failed", "an unexpected failure, which the server's log describes")
