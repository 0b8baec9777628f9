"""Requests to the server: repeated while it is away, refused with the sentence that it gives.

A request that does something carries an `Idempotency-Key`, the same in every try: an answer that was lost on the way
back does not do it twice.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx2

from lbacal_core.errors import LbacalError

TIMEOUT_S = 60.0
TRIES = 6
FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
AWAY = (429, 502, 503, 504)


class RefusedError(LbacalError):
    """The server answered with a problem; `status` is its HTTP status, `code` its short name."""

    def __init__(self, status: int, code: str, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code


class UnreachableError(LbacalError):
    """No server answers."""

    status = 503
    code = "unreachable"


@dataclass
class Transport:
    """One connection to one server. Every request can be repeated without harm, so it is."""

    url: str
    api_key: str | None = None
    tries: int = TRIES
    _http: httpx2.Client = field(init=False, repr=False)

    def __post_init__(self) -> None:
        headers = {} if self.api_key is None else {"Authorization": f"Bearer {self.api_key}"}
        self._http = httpx2.Client(base_url=self.url, headers=headers, timeout=TIMEOUT_S)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def request(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None,
        file: bytes | None = None,
    ) -> httpx2.Response:  # fmt: skip
        """Ask, with a JSON body or a spectra file, and ask again while nobody answers or the server is busy."""
        given = {name: value for name, value in (params or {}).items() if value is not None}
        headers = {} if method == "GET" else {"Idempotency-Key": uuid.uuid4().hex}
        if file is not None:
            headers["Content-Type"] = "application/x-hdf5"
        pause, problem = FIRST_PAUSE_S, "no answer"
        for attempt in range(self.tries):
            if attempt > 0:
                time.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
            try:
                answer = self._http.request(method, path, params=given, json=body, content=file, headers=headers)
            except httpx2.TransportError as error:
                problem = str(error) or type(error).__name__
                continue
            if answer.status_code not in AWAY:
                return _accept(answer)
            problem = _problem(answer)[1]
            pause = max(pause, float(answer.headers.get("retry-after", "0") or 0))
        raise UnreachableError(f"{self.url} does not answer after {self.tries} tries ({problem}): is LBACAL_URL right?")


def _accept(answer: httpx2.Response) -> httpx2.Response:
    if answer.is_success:
        return answer
    code, detail = _problem(answer)
    raise RefusedError(answer.status_code, code, detail)


def _problem(answer: httpx2.Response) -> tuple[str, str]:
    try:
        content = answer.json()
        return str(content["type"]).rpartition(":")[2], str(content["detail"])
    except (ValueError, KeyError, TypeError):
        return "failed", f"{answer.status_code} {answer.reason_phrase}"
