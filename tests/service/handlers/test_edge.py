from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi import Request, Response
from fastapi.testclient import TestClient
from prometheus_client import CollectorRegistry

from service.app import make_app
from service.factory import Factory
from service.handlers import edge
from service.handlers.edge import STRICT, Edge
from service.handlers.metrics import Traffic


def test_an_unexpected_failure_is_a_problem_with_the_headers_of_every_answer(factory: Factory) -> None:
    app = make_app(factory)

    @app.get("/fails")
    def fail() -> None:
        raise ZeroDivisionError

    with TestClient(app) as client:  # an error that passed the edge would be raised here
        answer = client.get("/fails", headers={"X-Request-ID": "mine-1"})
    assert (answer.status_code, answer.headers["content-type"]) == (500, "application/problem+json")
    assert answer.headers["content-security-policy"] == STRICT
    assert answer.headers["x-request-id"] == "mine-1"
    assert "ZeroDivisionError" not in answer.text


@pytest.mark.parametrize(
    "address",
    [
        "/v1/calibrations/effective?at=2014-05-01&tag=%00", "/v1/investigations?station=%00", "/v1/cuts?station=a%00b",
        "/v1/alarms?station=%00", "/v1/jobs?%00=1", "/v1/calibrations?station=%00", "/v1/events/a%00/flag",
        "/stations/%00", "/calibrations/%00",
    ],
)  # fmt: skip
def test_nul_in_an_address_was_a_failure_on_one_database_and_nothing_on_the_other(
    client: TestClient, address: str
) -> None:
    answer = client.get(address)
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
    assert "expected text without NUL, found NUL (%00)" in answer.json()["detail"]
    assert answer.headers["content-security-policy"] == STRICT


def test_a_percent_sign_before_two_zeros_is_text(client: TestClient) -> None:
    assert client.get("/v1/cuts?station=%2500").status_code == 200


def test_a_number_that_could_write_into_the_log_is_replaced(client: TestClient) -> None:
    given = client.get("/healthz", headers={"X-Request-ID": "two words"}).headers["x-request-id"]
    assert len(given) == 32


SCOPE = {"type": "http", "method": "POST", "path": "/x", "headers": [], "client": ("here", 1), "query_string": b""}


async def read_whole(scope: Any, receive: Any, send: Any) -> None:
    await Response(await Request(scope, receive).body())(scope, receive, send)


def ask(app: Any, parts: list[bytes | None]) -> tuple[int, dict[bytes, bytes]]:
    """Post a body in parts; None stands for one that never comes."""
    sent: list[Any] = []
    coming = iter(parts)

    async def receive() -> Any:
        part = next(coming)
        if part is None:
            await asyncio.Event().wait()
        return {"type": "http.request", "body": part, "more_body": part != b"end"}

    async def send(message: Any) -> None:
        sent.append(message)

    run(app(SCOPE, receive, send))
    return sent[0]["status"], dict(sent[0]["headers"])


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run in a thread of its own: the browser of another test keeps a loop running in this one."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, work).result()


def make_edge(app: Any) -> Edge:
    return Edge(app, Traffic(CollectorRegistry()), 100.0)


def test_a_body_that_never_ends_is_answered_and_its_connection_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edge, "BODY_S", 0.05)
    status, headers = ask(make_edge(read_whole), [b"a", None])
    assert (status, headers[b"connection"]) == (408, b"close")
    assert ask(make_edge(read_whole), [b"a", b"end"])[0] == 200


def test_an_answer_that_never_comes_is_503(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(_scope: Any, receive: Any, _send: Any) -> None:
        await receive()
        await asyncio.Event().wait()

    monkeypatch.setattr(edge, "ANSWER_S", 0.02)
    monkeypatch.setattr(edge, "SLOT_S", 0.02)
    assert ask(make_edge(never), [b"end"])[0] == 503


def test_a_client_that_leaves_is_not_a_failure() -> None:
    registry = CollectorRegistry()

    async def leave() -> Any:
        return {"type": "http.disconnect"}

    async def send(_message: Any) -> None:
        raise AssertionError

    run(Edge(read_whole, Traffic(registry), 100.0)(SCOPE, leave, send))
    counted = {"method": "POST", "route": "none", "status": "499"}
    assert registry.get_sample_value("lbacal_requests_total", counted) == 1


def test_more_writers_than_places_are_told_to_come_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edge, "SLOT_S", 0.02)
    monkeypatch.setattr(edge, "WRITERS", 0)

    async def answer_problems(scope: Any, receive: Any, send: Any) -> None:
        try:
            await read_whole(scope, receive, send)
        except edge.UnavailableError as error:
            await edge.problem_of(error)(scope, receive, send)

    assert ask(make_edge(answer_problems), [b"end"])[0] == 503


def test_an_answer_that_needed_a_key_is_kept_by_no_cache_between(factory: Factory) -> None:
    closed = Factory(factory.settings.model_copy(update={"open_reads": False}), factory.clock)
    _, key = factory.keys.create(("read",))
    with TestClient(make_app(closed)) as client:
        page = client.get("/", headers={"Authorization": f"Bearer {key}"})
        assert page.headers["cache-control"] == "private, no-cache"
        assert client.get("/").status_code == 401
