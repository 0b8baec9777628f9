"""What handlers ask of a request: the factory, the body, the caller; and how they answer."""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Annotated, Any, cast

from fastapi import Depends, Path, Query, Request, Response, Security
from fastapi.responses import StreamingResponse
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BeforeValidator

from lbacal_core.errors import BadInputError
from service.errors import TooLargeError, TooManyError, UnauthenticatedError, UnavailableError, UnsupportedMediaError
from service.factory import Factory
from service.handlers.edge import Buckets
from service.usecases.calibrations import select_paths
from service.usecases.keys import Caller
from service.wire.answers import choose_media, to_json

IMMUTABLE = "public, max-age=31536000, immutable"
REVALIDATE = "no-cache"
SESSION_COOKIE, FORM_COOKIE = "lbacal_session", "lbacal_form"
HDF5 = "application/x-hdf5"
SMALL_BODY = 65_536
"""Bytes of a body that changes one thing; the longest reason takes 24,000."""
LARGE_BODY = 4_000_000
"""Bytes from which a body waits for its turn: as values it takes ten times its size in memory."""

LARGE_READS = 4
"""Reads about many paths that are worked on at once; each may take tens of MB."""
TURN_S = 5.0
"""How long such a read waits for its turn."""


def _require_digits(value: Any) -> Any:
    """Pydantic also takes `1.0`, `1_0` and the digits of other scripts for the number they mean."""
    if isinstance(value, str) and re.fullmatch("[0-9]{1,19}", value) is None:
        raise ValueError("a whole number in digits, 0 or more")
    return value


Whole = Annotated[int, BeforeValidator(_require_digits)]
Limit = Annotated[Whole, Query(ge=1, le=1000, description="most items in the answer")]
AntennaQuery = Annotated[Whole | None, Query(ge=0, le=2**31 - 1)]
JobNumber = Annotated[Whole, Path(ge=1, le=2**63 - 1)]
InPath = Annotated[str, Path(pattern=r"^[^\x00-\x1f\x7f]{1,200}$")]
"""A name in an address."""


async def _provide_factory(request: Request) -> Factory:
    return cast("Factory", request.app.state.factory)


BEARER = HTTPBearer(scheme_name="key", description="A key made by `lbacal keys create`.", auto_error=False)
Bearer = Annotated[HTTPAuthorizationCredentials | None, Security(BEARER)]
"""For the OpenAPI document: what reads the header is `require_caller`."""

UseCases = Annotated[Factory, Depends(_provide_factory)]
"""Asynchronous, as all that does not wait: what is not changes threads, which takes longer than it does."""


async def _require_station(use: UseCases, station: str | None = None) -> str | None:
    select_paths(use.full_instrument, station, None, None)
    return station


StationQuery = Annotated[str | None, Depends(_require_station)]
"""The station of which a list is asked for: one of the instrument, as a misspelt one would seem to have nothing."""


def require_caller(
    request: Request, use: Factory, *scopes: str, authorization: str | None = None, session: str | None = None
) -> Caller:
    """Find the caller, if they may; an address that tries many wrong keys has to wait.

    `authorization` is that of the request unless it is given: its header. A session is taken where a form was sent with
    it; and where reads need a key that of the browser, for reads alone.
    """
    authorization = authorization or request.headers.get("authorization")
    if authorization is None and scopes == ("read",) and request.method == "GET" and not use.settings.open_reads:
        session = session or request.cookies.get(SESSION_COOKIE)
    try:
        caller = use.keys.require(authorization, *scopes, session=session)
    except UnauthenticatedError:
        if authorization is not None or session is not None:
            wait = cast("Buckets", request.app.state.wrong_keys).take(request.client.host if request.client else "")
            if wait > 0:
                raise TooManyError("too many wrong keys came from this address", wait) from None
        raise
    request.state.caller = caller.name
    return caller


async def require_known_query(request: Request) -> None:
    """Refuse a query parameter that the route does not have: a misspelt filter must not answer about everything."""
    known = set(_list_query(request.scope["route"].dependant))
    seen: set[str] = set()
    for name, _ in request.query_params.multi_items():
        if name not in known:
            raise BadInputError("query", f"only {', '.join(sorted(known))}" if known else "no parameter", name[:60])
        if name in seen:
            raise BadInputError("query", f"{name} once", "it twice")
        seen.add(name)


def _list_query(dependant: Any) -> Iterator[str]:
    """The query parameters of a route and of what it depends on."""
    yield from (parameter.alias for parameter in dependant.query_params)
    for one in dependant.dependencies:
        yield from _list_query(one)


async def require_acceptable(request: Request) -> None:
    """Refuse, before anything is done, a client that takes nothing of what the route answers.

    A route with `format=` chooses by itself, and a file of the page has the type that it has.
    """
    route = request.scope["route"]
    media = getattr(route.response_class, "value", route.response_class).media_type
    if media is not None and not any(parameter.alias == "format" for parameter in route.dependant.query_params):
        choose_media({"": media}, request.headers.get("accept"))


async def take_turn(request: Request) -> AsyncIterator[None]:
    """Work on few large reads at once: many of them must leave threads, connections and memory to everybody else.

    What is asked about one antenna is small. The turn ends with the work, and not when a slow client has read it.
    """
    if "antenna" in request.query_params:
        yield
        return
    turns: asyncio.Semaphore = request.app.state.large_reads
    try:
        async with asyncio.timeout(TURN_S):
            await turns.acquire()
    except TimeoutError as error:
        sentence = f"{LARGE_READS} answers about many paths are being made, as many as this server makes at once"
        raise UnavailableError(sentence) from error
    try:
        yield
    finally:
        turns.release()


TAKES_TURN = Depends(take_turn, scope="function")


def caller_with(*scopes: str) -> Any:
    """A dependency that yields a caller who holds the scopes."""

    def require(request: Request, use: UseCases, _bearer: Bearer) -> Caller:
        return require_caller(request, use, *scopes)

    return Depends(require)


MAY_READ = caller_with("read")


async def read_json_body(request: Request) -> bytes:
    """The body of a JSON request that changes one thing."""
    return await _read_body(request, ("application/json",), SMALL_BODY, "")


async def read_optional_json_body(request: Request) -> bytes:
    """The same where a request may have no body; nothing then."""
    is_absent = "content-type" not in request.headers and request.headers.get("content-length", "0") == "0"
    return b"" if is_absent and "transfer-encoding" not in request.headers else await read_json_body(request)


async def read_form_body(request: Request) -> bytes:
    """The body of a form on one of our pages."""
    return await _read_body(request, ("application/x-www-form-urlencoded",), SMALL_BODY, "")


async def read_spectra_body(request: Request, use: UseCases) -> AsyncIterator[bytes]:
    """The body of a batch of spectra, of the largest size allowed; large ones are worked on one at a time."""
    limit = round(use.settings.max_body_mb * 1e6)
    body = await _read_body(request, ("application/json", HDF5), limit, " (LBACAL_MAX_BODY_MB)")
    turn: AbstractAsyncContextManager[object] = request.app.state.large_bodies
    async with turn if len(body) > LARGE_BODY else nullcontext():
        yield body


def media_type_of(request: Request) -> str:
    """Find the media type of a request's body."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def _read_body(request: Request, media_types: Sequence[str], limit: int, setting: str) -> bytes:
    media = media_type_of(request)
    if media not in media_types:
        expected = " or ".join(media_types)
        raise UnsupportedMediaError(f"this route reads {expected}, not {media or 'an unnamed type'}")
    announced = request.headers.get("content-length", "0")
    if announced.isdigit() and int(announced) > limit:
        raise TooLargeError(f"the body has {announced} bytes, {limit} are allowed{setting}")
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit:
            raise TooLargeError(f"the body has more than the {limit} bytes allowed{setting}")
    return bytes(body)


JsonBody = Annotated[bytes, Depends(read_json_body)]
OptionalJsonBody = Annotated[bytes, Depends(read_optional_json_body)]
SpectraUpload = Annotated[bytes, Depends(read_spectra_body)]


def answer(
    request: Request,
    content: bytes | Any,
    *,
    status: int = 200,
    media_type: str = "application/json",
    cache: str = REVALIDATE,
) -> Response:
    """Answer with content; a client that holds the same bytes gets 304."""
    body = content if isinstance(content, bytes) else to_json(content)
    headers, is_held = _head(request, body, cache)
    return Response(status_code=304, headers=headers) if is_held else Response(body, status, headers, media_type)


def answer_in_pieces(request: Request, pieces: Iterator[bytes], size: int, named: str, cache: str) -> Response:
    """Answer with JSON of so many bytes, never whole in memory, whose content has a name; otherwise as `answer`."""
    headers, is_held = _head(request, named.encode(), cache)
    if is_held:
        return Response(status_code=304, headers=headers)

    async def send() -> AsyncIterator[bytes]:
        for piece in pieces:
            yield piece

    headers["Content-Length"] = str(size)
    return StreamingResponse(send(), headers=headers, media_type="application/json")


def _head(request: Request, named: bytes, cache: str) -> tuple[dict[str, str], bool]:
    """The headers of an answer that is known by some bytes, and whether the client holds it."""
    etag = f'"{hashlib.sha256(named).hexdigest()}"'
    is_open = cast("Factory", request.app.state.factory).settings.open_reads
    if not is_open:
        # what needs a key is for its holder: no cache between may keep it for others (RFC 9111, 3.5)
        cache = f"private, {cache.removeprefix('public, ')}"
    headers = {"ETag": etag, "Cache-Control": cache, "Vary": "Accept" if is_open else "Accept, Authorization, Cookie"}
    known = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
    return headers, request.method in ("GET", "HEAD") and etag in known
