"""The two kinds of routes of the API: one reads, the other changes something for a caller who may."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar, cast

from fastapi import APIRouter, Depends, Header
from pydantic import BaseModel

from service.factory import Factory
from service.handlers.problems import document
from service.handlers.request import MAY_READ, TAKES_TURN, JsonBody, UseCases, caller_with
from service.usecases.keys import Caller
from service.usecases.orders import do_once, recall_answer
from service.wire.answer_models import Answer
from service.wire.answers import FORMATS, to_json
from service.wire.bodies import AnyBody, parse_body

Handler = TypeVar("Handler", bound=Callable[..., Any])
Decorator = Callable[[Handler], Handler]
FILES: dict[int | str, Any] = {200: {"content": {one: {} for one in FORMATS.values() if one != "application/json"}}}
"""What routes with `format=` answer."""


def reads(
    router: APIRouter, path: str, answered: type[Answer], *errors: int, takes_turn: bool = False, files: bool = False
) -> Decorator[Any]:
    """Declare a route for who may read; the docstring of its handler is what the OpenAPI document says of it.

    Parameters
    ----------
    errors
        Statuses beside 401, 422 and 503.
    takes_turn
        Whether it is one of the large reads (`take_turn`).
    files
        Whether it also answers in the formats of `format=`.
    """
    turn = [TAKES_TURN] if takes_turn else []
    more = document(*errors) | (FILES if files else {})

    def declare(handler: Handler) -> Handler:
        route = router.get(
            path, response_model=answered, **_described(handler), responses=document(401, 422, 503) | more,
            dependencies=[MAY_READ, *turn],
        )  # fmt: skip
        return route(handler)

    return declare


def acts(
    router: APIRouter, path: str, body: type[BaseModel], answered: type[Answer], *errors: int, status: int = 201,
    method: str = "POST", otherwise: type[Answer] | None = None, media: str = "", is_body_required: bool = True,
) -> Decorator[Any]:  # fmt: skip
    """Declare a route that changes something; the docstring of its handler is what the OpenAPI document says of it.

    Parameters
    ----------
    errors
        Statuses beside those that come of a body and a key.
    otherwise
        What it answers with 200: of a dry run, or where nothing was new.
    media
        Type of a file that may stand for the body.
    """
    content: dict[str, Any] = {"application/json": {"schema": _inline(body)}}
    content |= {media: {"schema": {"type": "string", "format": "binary"}}} if media else {}
    more: dict[int | str, dict[str, Any]] = (
        {200: {"model": otherwise, "description": "nothing was written"}} if otherwise else {}
    )

    def declare(handler: Handler) -> Handler:
        route = router.api_route(
            path, methods=[method], status_code=status, response_model=answered, **_described(handler),
            responses=document(400, 401, 403, 415, 422, 503, *errors) | more,
            openapi_extra={"requestBody": {"required": is_body_required, "content": content}},
        )  # fmt: skip
        return route(handler)

    return declare


def _described(handler: Callable[..., Any]) -> dict[str, Any]:
    """The first line of a docstring, and the rest."""
    summary, _, description = inspect.cleandoc(handler.__doc__ or "").partition("\n\n")
    return {"summary": summary.removesuffix("."), "description": description}


def _inline(body: type[BaseModel]) -> dict[str, Any]:
    """The JSON schema of a body with its parts written out where they are used."""
    schema = body.model_json_schema()
    parts = schema.pop("$defs", {})

    def fill(node: Any) -> Any:
        if isinstance(node, dict):
            name = str(node.get("$ref", "")).rpartition("/")[2]
            return fill(parts[name]) if name else {key: fill(value) for key, value in node.items()}
        return [fill(value) for value in node] if isinstance(node, list) else node

    return cast("dict[str, Any]", fill(schema))


@dataclass(frozen=True)
class Order(Generic[AnyBody]):
    """A request of an authorised caller, done at most once under a name of their choice."""

    wanted: AnyBody
    caller: str
    _use: Factory
    _body: bytes
    _name: str | None

    def recall(self, what: str) -> bytes | None:
        """Find the answer of the same request under its name; None where it is new."""
        return recall_answer(self._use.database, self.caller, self._name, what.encode() + self._body)

    def once(self, what: str, act: Callable[[], Any]) -> bytes:
        """Do it, unless it was done under its name; the answer as JSON.

        `what` tells requests of the same body apart. `act` gives JSON values, or their bytes.
        """
        use, request = self._use, what.encode() + self._body
        return do_once(use.database, use.clock(), self.caller, self._name, request, lambda: _as_bytes(act()))


def _as_bytes(content: Any) -> bytes:
    return content if isinstance(content, bytes) else to_json(content)


def ordered(body: type[AnyBody], scope: str) -> Any:
    """A dependency that yields the order of a caller whose key has a scope, one of `usecases.keys.SCOPES`."""
    who = caller_with(scope)

    async def read(
        use: UseCases,
        content: JsonBody,
        caller: Caller = who,
        idempotency_key: Annotated[
            str | None, Header(description="a name of your choice: the same request under it is done once, for a week")
        ] = None,
    ) -> Order[AnyBody]:
        return Order(parse_body(body, content), caller.name, use, content, idempotency_key)

    return Depends(read)


def page_of(
    name: str, found: Sequence[Any], limit: int, describe: Callable[[Any], Any], cursor: Callable[[Any], Any]
) -> dict[str, Any]:
    """A page of a list under its name, and as `next` the cursor of the next one, None where there is none."""
    following = cursor(found[-1]) if len(found) == limit else None
    return {name: [describe(one) for one in found], "next": following}
