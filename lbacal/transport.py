"""Requests to the server: repeated while it is away, refused with the sentence that it gives.

A request that does something carries an `Idempotency-Key`, the same in every try: an answer that was lost on the way
back does not do it twice.
"""

from __future__ import annotations

import io
import math
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import LbacalError
from lbacal_core.spectra.spectra import Spectra, write_spectra

if TYPE_CHECKING:
    import httpx2

TIMEOUT_S = 60.0
QUICK_S = 2.0
"""A question that a cache may answer instead, or a human waits for, finds within this time that nobody is there."""
QUICK_CONNECT_S = 1.5
STUCK_S = 10.0
"""A server that took a question and is silent for this long is stuck, if something else can answer."""
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


class UnreachableError(LbacalError, status=503, code="unreachable"):
    """No server answers."""


@dataclass
class Transport:
    """One connection to one server. Every request can be repeated without harm, so it is."""

    url: str
    api_key: str | None = None
    tries: int = TRIES
    _http: httpx2.Client = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import httpx2  # slow to load, and only who asks a server needs it

        headers = {} if self.api_key is None else {"Authorization": f"Bearer {self.api_key}"}
        self._http = httpx2.Client(base_url=self.url, headers=headers, timeout=TIMEOUT_S)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def request(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None,
        file: bytes | None = None, is_quick: bool = False, tries: int | None = None,
        answer_s: float = TIMEOUT_S,
    ) -> httpx2.Response:  # fmt: skip
        """Ask, with a JSON body or a spectra file, and ask again while nobody answers or the server is busy.

        `UnreachableError` is raised after the last of `tries` (those of the transport unless given), `RefusedError` at
        once for a status that says no. With `is_quick` it is known after `QUICK_S` that nobody is there, and after
        `answer_s` that a server which took the question is stuck.
        """
        import httpx2

        given = {name: value for name, value in (params or {}).items() if value is not None}
        headers = {} if method == "GET" else {"Idempotency-Key": uuid.uuid4().hex}
        if file is not None:
            headers["Content-Type"] = "application/x-hdf5"
        more: dict[str, Any] = {"timeout": httpx2.Timeout(answer_s, connect=QUICK_CONNECT_S)} if is_quick else {}
        end = time.monotonic() + QUICK_S if is_quick else math.inf
        pause, problem = FIRST_PAUSE_S, UnreachableError("no answer")
        for attempt in range(tries or self.tries):
            if attempt > 0:
                if time.monotonic() + pause + QUICK_CONNECT_S > end:
                    break
                time.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
            try:
                answer = self._http.request(
                    method, path, params=given, json=body, content=file, headers=headers, **more
                )
            except httpx2.TransportError as error:
                reason = str(error) or type(error).__name__
                advice = "start `lbacal serve` there, or set LBACAL_URL"
                problem = UnreachableError(f"nobody answers at {self.url} ({reason}): {advice}")
                continue
            if answer.is_success:
                return answer
            code, detail = _problem(answer)
            if answer.status_code not in AWAY:
                raise RefusedError(answer.status_code, code, detail)
            # the server is there: nothing is wrong with its address
            problem = UnreachableError(f"the server at {self.url} cannot answer now ({detail}): ask again later")
            pause = max(pause, float(answer.headers.get("retry-after", "0") or 0))
        raise problem


def _problem(answer: httpx2.Response) -> tuple[str, str]:
    try:
        content = answer.json()
        return str(content["type"]).rpartition(":")[2], str(content["detail"])
    except (ValueError, KeyError, TypeError):
        return "failed", f"{answer.status_code} {answer.reason_phrase}"


# What a client sends: the spectra of whole events as a request body, a spectra file.


def files_of_events(spectra: Spectra, at_least: int = 1) -> Iterator[tuple[int, int, bytes]]:
    """Whole events as files, with the numbers of their events and spectra; the same spectra make the same bytes.

    Parameters
    ----------
    at_least
        Each file but the last takes events until it holds as many spectra.
    """
    bundle: list[NDArray[np.int64]] = []
    for rows in chain(_rows_of_events(spectra), [None]):
        if bundle and (rows is None or sum(event.size for event in bundle) >= at_least):
            file, chosen = io.BytesIO(), np.concatenate(bundle)
            write_spectra(spectra.select(chosen), file)
            yield len(bundle), chosen.size, file.getvalue()
            bundle = []
        if rows is not None:
            bundle.append(rows)


def _rows_of_events(spectra: Spectra) -> Iterator[NDArray[np.int64]]:
    """The rows of each event, in order of the events' first times."""
    if len(spectra) == 0:
        return
    names, code = spectra.key_codes["event_id"]
    first = np.full(names.size, np.inf)
    np.minimum.at(first, code, spectra.time_unix)
    order = np.lexsort((code, first[code]))
    edges = np.flatnonzero(np.diff(code[order])) + 1
    yield from np.split(order, edges)
