"""What every request passes: its number, its deadlines, its line in the log, and the headers of every answer."""

from __future__ import annotations

import asyncio
import re
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit, urlunsplit

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lbacal_core.errors import BadInputError
from service.errors import SlowBodyError, TooManyError, UnavailableError
from service.handlers.problems import problem, problem_of

# How much one caller may ask for: buckets that fill with time, one for each address.

MOST_REMEMBERED = 10_000
BAD_KEYS_AT_ONCE = 10
BAD_KEYS_PER_S = 1 / 6
"""An address may try ten wrong keys, and then ten a minute; right ones are let through, whoever else tries there."""


@dataclass
class Buckets:
    """One bucket a name: it holds `size` tokens and gains `rate` a second; what is done takes one."""

    rate: float
    size: float
    clock: Callable[[], float] = time.monotonic
    _filled: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def take(self, name: str) -> float:
        """Take a token and return 0; where there is none, return the seconds until there is one."""
        with self._lock:
            now = self.clock()
            level, since = self._filled.pop(name, (self.size, now))
            level = min(self.size, level + self.rate * (now - since))
            is_enough = level >= 1.0
            self._filled[name] = (level - 1.0 if is_enough else level, now)
            if len(self._filled) > MOST_REMEMBERED:
                self._filled.popitem(last=False)  # asked least recently
            return 0.0 if is_enough else (1.0 - level) / self.rate


# What Prometheus reads of the requests to this process.

_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)


class Traffic:
    """Counts of requests and their times."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._requests = Counter(
            "lbacal_requests", "Requests answered.", ["method", "route", "status"], registry=registry
        )
        self._seconds = Histogram(
            "lbacal_request_seconds", "Time from the request to its answer, s.", ["method", "route"],
            buckets=_SECONDS, registry=registry,
        )  # fmt: skip

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)


_ELSEWHERE = "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
STRICT = f"default-src 'none'; script-src 'self'; style-src 'self'; {_ELSEWHERE}"
"""A browser loads what this host serves, and takes no script and no style written into a page."""
DOCS = f"default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; {_ELSEWHERE}"
"""The pages of FastAPI's documentation carry a script in the page; they show nothing that anybody sent."""

ANSWER_S = 60.0
"""An answer takes this long at most, from the end of the request's body."""
BODY_S, BODY_BYTES_PER_S = 10.0, 50_000.0
"""A body comes within ten seconds, and one more for every 50 kB of it."""
WRITERS = 16
"""Requests with a body that are worked on at once: fewer than there are threads, so that some are left for readers."""
SLOT_S = 5.0
CLIENT_LEFT = 499
QUIET = ("/healthz", "/readyz", "/metrics", "/static/")
_NUMBER = re.compile(r"[A-Za-z0-9._-]{1,64}")

log = structlog.get_logger()


class Edge:
    """The outermost layer of the application."""

    def __init__(self, app: ASGIApp, traffic: Traffic, max_rate: float) -> None:
        self._app = app
        self._traffic = traffic
        self._rates = Buckets(max_rate, 10.0 * max_rate)
        self._slots = asyncio.Semaphore(WRITERS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and answer for it whatever happens inside."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        number = given if _NUMBER.fullmatch(given) else uuid.uuid4().hex
        exchange = _Exchange(scope, receive, send, number, self._slots)
        with structlog.contextvars.bound_contextvars(request=number):
            await self._serve(exchange)
            self._tell(exchange)

    async def _serve(self, exchange: _Exchange) -> None:
        try:
            self._require_share(exchange.address)
            exchange.require_text()
            async with asyncio.timeout(ANSWER_S) as exchange.deadline:
                await self._app(exchange.scope, exchange.receive, exchange.send)
        except (TooManyError, BadInputError) as error:
            await exchange.answer(problem_of(error))
        except ClientDisconnect:
            exchange.status = CLIENT_LEFT
        except TimeoutError as error:
            if exchange.deadline is None or not exchange.deadline.expired():
                await exchange.fail(error)
            elif exchange.is_body_awaited:
                await exchange.answer(problem_of(SlowBodyError("the body came too slowly, or not to its end")))
            else:
                await exchange.answer(problem_of(UnavailableError(f"no answer within {ANSWER_S:g} s")))
        except Exception as error:  # noqa: BLE001 - whatever a request does wrong, the server answers and goes on
            await exchange.fail(error)
        finally:
            exchange.release()

    def _require_share(self, address: str) -> None:
        wait = self._rates.take(address)
        if wait > 0:
            raise TooManyError("too many requests came from this address", wait)

    def _tell(self, exchange: _Exchange) -> None:
        scope, seconds = exchange.scope, time.perf_counter() - exchange.begun
        method, route = str(scope["method"]), scope.get("route")
        # all paths that no route has count as one
        self._traffic.count(method, str(getattr(route, "path", "none")), exchange.status, seconds)
        # the number of the key that was accepted, never its text; None without a key
        caller = scope.get("state", {}).get("caller")
        write = log.debug if exchange.path.startswith(QUIET) else log.info
        write(
            "request", method=method, path=exchange.path, status=exchange.status,
            ms=round(1000 * seconds, 1), client=exchange.address, caller=caller,
        )  # fmt: skip


class _Exchange:
    """One request and its answer."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, number: str, slots: asyncio.Semaphore) -> None:
        self.scope = scope
        self.begun = time.perf_counter()
        self.status = 0
        self.deadline: asyncio.Timeout | None = None
        self.is_body_awaited = False
        self._receive, self._send, self._number, self._slots = receive, send, number, slots
        self._body_begun: float | None = None
        self._received = 0
        self._has_slot = False

    @property
    def path(self) -> str:
        """Path of the request, without the query."""
        return str(self.scope["path"])

    @property
    def address(self) -> str:
        """Where the request came from."""
        client = self.scope.get("client")
        return str(client[0]) if client else "unknown"

    def require_text(self) -> None:
        """Refuse an address with NUL, which no text of a database holds."""
        for place, part, nul in (("path", self.path, "\0"), ("query", self.scope["query_string"], b"%00")):
            if nul in part:
                raise BadInputError(place, "text without NUL", "NUL (%00)")

    async def receive(self) -> Message:
        """The next part of the body; at its end the request takes its place among those that are worked on."""
        now = asyncio.get_running_loop().time()
        if self._body_begun is None:
            self._body_begun, self.is_body_awaited = now, True
            self._allow_until(now + BODY_S)
        message = await self._receive()
        if message["type"] == "http.request":
            self._received += len(message.get("body", b""))
            if message.get("more_body"):
                self._allow_until(self._body_begun + BODY_S + self._received / BODY_BYTES_PER_S)
            elif self.is_body_awaited:
                self.is_body_awaited = False
                self._allow_until(asyncio.get_running_loop().time() + SLOT_S + ANSWER_S)
                await self._take_slot()
        return message

    def _allow_until(self, when: float) -> None:
        if self.deadline is not None and not self.deadline.expired():
            self.deadline.reschedule(when)

    async def _take_slot(self) -> None:
        try:
            async with asyncio.timeout(SLOT_S):
                await self._slots.acquire()
        except TimeoutError as error:
            raise UnavailableError("the server is busy with what others sent") from error
        self._has_slot = True

    def release(self) -> None:
        """Leave the place to the next."""
        if self._has_slot:
            self._slots.release()

    async def send(self, message: Message) -> None:
        """Pass the answer on, with the headers of all answers."""
        if message["type"] == "http.response.start":
            self.status = int(message["status"])
            headers = MutableHeaders(scope=message)
            headers["Content-Security-Policy"] = DOCS if self.path == "/docs" else STRICT
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "same-origin"
            headers["X-Request-ID"] = self._number
            if self.is_body_awaited:
                headers["Connection"] = "close"  # what is left of the body is not a request
            if "location" in headers:  # the framework writes the host that the client named
                headers["Location"] = urlunsplit(urlsplit(headers["location"])._replace(scheme="", netloc=""))
        await self._send(message)

    async def answer(self, response: ASGIApp) -> None:
        """Answer in place of the application, unless it has begun to."""
        if self.status == 0:
            await response(self.scope, self._receive, self.send)

    async def fail(self, error: Exception) -> None:
        """Log an error of this program once, and answer."""
        log.error("unexpected failure", path=self.path, exc_info=error)
        await self.answer(problem(500, "failed", "an unexpected failure, which the server's log describes"))


# HEAD: what GET would answer, without its body.


class AnswersHead:
    """Lets every route that answers GET answer HEAD."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass HEAD on as GET, and the answer back without its body."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        async def send_without_body(message: Message) -> None:
            scope["method"] = "HEAD"  # the same scope is the server's, who sends no body because of it
            await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

        scope["method"] = "GET"
        try:
            await self._app(scope, receive, send_without_body)
        finally:
            scope["method"] = "HEAD"
