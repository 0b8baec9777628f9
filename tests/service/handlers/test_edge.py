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
from service.handlers import edge, request
from service.handlers.edge import BAD_KEYS_AT_ONCE, STRICT, Buckets, Edge, Traffic
from service.handlers.request import LARGE_READS
from tests.service.conftest import bearer, like


@pytest.mark.long
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
        "/v1/calibrations/effective?at=2014-05-01&tag=%00", "/v1/investigations?station=%00",
        "/v1/changes?station=a%00b",
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
    assert client.get("/v1/events?flag=%2500").status_code == 200


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
    with like(factory, open_reads=False) as closed, TestClient(make_app(closed)) as client:
        page = client.get("/", headers=bearer(factory, "read"))
        assert page.headers["cache-control"] == "private, no-cache"
        assert client.get("/").status_code == 401


def test_a_tenth_wrong_key_is_told_to_wait_and_a_right_one_is_not(factory: Factory, client: TestClient) -> None:
    """Ten wrong keys locked out every right one that had not been used since the server started."""
    wrong = [client.get("/v1/jobs", headers={"Authorization": f"Bearer no{k}"}) for k in range(BAD_KEYS_AT_ONCE + 1)]
    assert [answer.status_code for answer in wrong] == [401] * BAD_KEYS_AT_ONCE + [429]
    assert int(wrong[-1].headers["retry-after"]) > 0
    assert client.get("/v1/jobs").status_code == 200
    made = bearer(factory, "read")
    assert client.get("/v1/jobs", headers=made).status_code == 200
    (number,) = [
        one.number for one in factory.database.look(lambda stores: stores.keys.all()) if one.scopes == ("read",)
    ]
    factory.keys.revoke(number)
    assert client.get("/v1/jobs", headers=made).status_code == 429, "a revoked key is a wrong one"


def test_a_redirect_does_not_lead_to_the_host_that_the_client_named(client: TestClient) -> None:
    answer = client.get("/v1/jobs/?limit=5", headers={"Host": "evil.example"}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (307, "/v1/jobs?limit=5")


def test_a_flood_is_told_to_wait(factory: Factory) -> None:
    with like(factory, max_rate=0.001) as slow, TestClient(make_app(slow)) as client:
        answer = client.get("/healthz")
    assert (answer.status_code, answer.json()["type"]) == (429, "urn:lbacal:too_many")


def test_a_bucket_fills_with_time() -> None:
    now = [0.0]
    buckets = Buckets(rate=2.0, size=3.0, clock=lambda: now[0])
    assert [buckets.take("a") for _ in range(4)] == [0, 0, 0, 0.5]
    assert buckets.take("b") == 0, "one address does not take from another"
    now[0] = 0.5
    assert [buckets.take("a"), buckets.take("a")] == [0, 0.5]


@pytest.mark.long
@pytest.mark.parametrize(
    "path", ["/healthz", "/v1/events", "/", "/v1/calibrations/effective?at=2014-05-01", "/openapi.json"]
)
def test_head_answers_what_get_answers_without_the_body(client: TestClient, path: str) -> None:
    get, head = client.get(path), client.head(path)
    assert (head.status_code, head.content) == (get.status_code, b"")
    for name in ("content-type", "content-length", "etag", "cache-control", "content-security-policy"):
        assert head.headers.get(name) == get.headers.get(name)


def test_head_of_what_is_held_is_not_modified_and_of_what_only_writes_not_allowed(client: TestClient) -> None:
    held = {"If-None-Match": client.head("/v1/events").headers["etag"]}
    assert client.head("/v1/events", headers=held).status_code == 304
    assert client.head("/v1/spectra").status_code == 405


LOCAL_MIN = "0001-01-01T00:00:00+14:00"


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/v1/jobs/9223372036854775808"), ("POST", "/v1/jobs/9223372036854775808/cancel"),
        ("GET", "/v1/jobs/" + "9" * 5000), ("GET", "/v1/jobs/1.0"), ("GET", "/v1/jobs/-1"), ("GET", "/v1/jobs/1_0"),
        ("GET", "/v1/jobs/%D9%A1"), ("GET", "/v1/jobs?cursor=1.0"), ("GET", "/v1/events?limit=1_0"),
        ("GET", "/v1/calibrations?antenna=1.0"),
        ("GET", "/v1/calibrations/effective?at=2014-05-01&station=CS001&antenna=9223372036854775808"),
        ("GET", "/v1/calibrations/%00"), ("GET", "/v1/calibrations/a%00b/diff/c"),
        ("GET", "/v1/calibrations/a/diff/%00"), ("POST", "/v1/events/%00/flag"),
    ],
)  # fmt: skip
def test_a_number_or_a_name_that_no_database_holds_is_refused_and_not_a_failure(
    client: TestClient, method: str, path: str
) -> None:
    body = {"json": {"flag": "x", "reason": "x"}} if method == "POST" else {}
    answer = client.request(method, path, **body)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_job_beyond_all_others_is_not_found(client: TestClient) -> None:
    assert client.get("/v1/jobs/9223372036854775807").status_code == 404


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/v1/refits", {"scope": "station", "since": LOCAL_MIN, "until": "2014-10-01", "reason": "x"}),
        ("/v1/promotions", {"calibration": None, "station": "CS001", "valid_from": LOCAL_MIN, "reason": "x"}),
        (
            "/v1/promotions",
            {
                "calibration": None, "station": "CS001", "valid_from": "2014-01-01",
                "valid_to": "9999-12-31T23:59:59-01:00", "reason": "x",
            },
        ),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("stored")
def test_a_local_datetime_min_poisoned_every_page_and_is_refused_now(
    client: TestClient, path: str, body: dict[str, Any]
) -> None:
    assert client.post(path, json=body).status_code == 422
    for page in ("/", "/stations/CS001", "/v1/calibrations", "/v1/jobs"):
        assert client.get(page).status_code == 200
    assert client.get("/v1/calibrations/effective", params={"at": LOCAL_MIN}).status_code == 422
    assert client.get("/v1/calibrations/effective", params={"at": "0001-01-01"}).status_code == 404


def test_five_questions_about_all_paths_at_once_kept_the_server_busy_for_everybody(
    factory: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those above the limit are told to come again; what is asked about one antenna needs no turn."""
    monkeypatch.setattr(request, "TURN_S", 0.02)
    app = make_app(factory)
    turns: asyncio.Semaphore = app.state.large_reads

    async def take_all() -> None:
        for _ in range(LARGE_READS):
            await turns.acquire()

    large = ("/v1/calibrations/effective?at=2014-05-01", "/v1/drift", "/", "/stations/CS001")
    small = "/v1/calibrations/effective?at=2014-05-01&station=CS001&antenna=0&dipole=X"
    with TestClient(app) as client, ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, take_all()).result()
        answers = [client.get(address) for address in large]
        assert [(answer.status_code, answer.headers["retry-after"]) for answer in answers] == [(503, "5")] * len(large)
        assert client.get(small).status_code == 404
        turns.release()
        for _ in range(2):  # a turn is given back, by failures too
            assert [client.get(address).status_code for address in large] == [404, 200, 200, 200]


@pytest.mark.parametrize(
    ("address", "told"), [("/v1/status?at=2014", "no parameter, found at"), ("/v1/tags?x=1", "only cursor")]
)
def test_a_route_without_parameters_expected_only_no_parameter(client: TestClient, address: str, told: str) -> None:
    answer = client.get(address)
    assert answer.status_code == 422
    assert f"query: expected {told}" in answer.json()["detail"]


WHY: dict[str, Any] = {"reason": "x"}
REFIT = {"scope": "antenna", "since": "2014-01-01", "until": "2015-01-01", **WHY}
NOBODY = "0" * 64
PROMOTION = {"calibration": NOBODY, "valid_from": "2014-01-01", **WHY}


def test_what_changes_something_needs_a_key_with_its_scope(factory: Factory, client: TestClient) -> None:
    for scopes, method, route, body in (
        ("read", "POST", "alarms/1/acknowledgement", WHY),
        ("read", "POST", "refits", REFIT),
        ("refits:run", "POST", "refits", REFIT | {"promote": True}),
        ("refits:run", "POST", "changes/1/decision", WHY | {"decision": "dismissed"}),
        ("refits:run", "POST", f"models/{NOBODY}/withdrawal", WHY),
        ("refits:run", "POST", f"investigations/{NOBODY}/adoption", WHY | {"finding": 0, "promote": False}),
        ("read spectra:write refits:run", "POST", "promotions", PROMOTION),
        ("read spectra:write refits:run", "PUT", "tags/v1", WHY),
        ("read spectra:write refits:run", "POST", "jobs/1/promotion", WHY),
        ("read spectra:write refits:run", "POST", "promotions/1/rollback", WHY),
    ):
        headers = bearer(factory, *scopes.split())
        answer = client.request(method, f"/v1/{route}", json=body, headers=headers)
        assert answer.status_code == 403, (scopes, route)
