from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.factory import Factory
from service.handlers import request
from service.handlers.request import LARGE_READS

LOCAL_MIN = "0001-01-01T00:00:00+14:00"


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/v1/jobs/9223372036854775808"),
        ("POST", "/v1/jobs/9223372036854775808/cancel"),
        ("GET", "/v1/jobs/" + "9" * 5000),
        ("GET", "/v1/jobs/1.0"),
        ("GET", "/v1/jobs/-1"),
        ("GET", "/v1/jobs/1_0"),
        ("GET", "/v1/jobs/%D9%A1"),
        ("GET", "/v1/jobs?cursor=1.0"),
        ("GET", "/v1/events?limit=1_0"),
        ("GET", "/v1/calibrations?antenna=1.0"),
        ("GET", "/v1/calibrations/effective?at=2014-05-01&station=CS001&antenna=9223372036854775808"),
        ("GET", "/v1/calibrations/%00"),
        ("GET", "/calibrations/%00"),
        ("GET", "/stations/%00"),
        ("GET", "/v1/calibrations/a%00b/diff/c"),
        ("GET", "/v1/calibrations/a/diff/%00"),
        ("POST", "/v1/events/%00/flag"),
    ],
)
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
    ("address", "told"), [("/?at=2014", "no parameter, found at"), ("/v1/tags?x=1", "only cursor")]
)
def test_a_route_without_parameters_expected_only_no_parameter(client: TestClient, address: str, told: str) -> None:
    answer = client.get(address)
    assert answer.status_code == 422
    assert f"query: expected {told}" in answer.json()["detail"]
