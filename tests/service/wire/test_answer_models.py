from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.wire.answer_models import (
    Answer,
    EventAnswer,
    EventsAnswer,
    JobAnswer,
    JobsAnswer,
    ReceiptAnswer,
    ReceiptsAnswer,
    RefitAnswer,
)

ROW = {
    "event_id": "e", "time_utc": "2014-03-01", "station": "CS001", "antenna": 0, "dipole": "X", "blocks": 100,
    "power": [1.0, 2.0, 3.0, 4.0], "env": {"rain_mm_h": 0.5},
}  # fmt: skip
BODY = json.dumps({"frequency_mhz": [30.0, 45.0, 60.0, 80.0], "spectra": [ROW]}).encode()
REFIT = {"scope": "station", "since": "2014-01-01", "until": "2015-01-01", "reason": "test"}


@pytest.fixture
def stored_client(client: TestClient) -> TestClient:
    client.post("/v1/spectra", content=BODY, headers={"Content-Type": "application/json"})
    client.post("/v1/refits", json=REFIT)
    return client


@pytest.mark.parametrize(
    ("model", "method", "path", "body"),
    [
        (ReceiptAnswer, "POST", "/v1/spectra", json.loads(BODY)),
        (ReceiptsAnswer, "GET", f"/v1/spectra/receipts?sha256={hashlib.sha256(BODY).hexdigest()}", None),
        (EventsAnswer, "GET", "/v1/events?limit=1", None),
        (EventAnswer, "POST", "/v1/events/e/flag", {"flag": "thunder", "reason": "test"}),
        (RefitAnswer, "POST", "/v1/refits", REFIT),
        (JobAnswer, "GET", "/v1/jobs/1", None),
        (JobsAnswer, "GET", "/v1/jobs?limit=1", None),
        (JobAnswer, "POST", "/v1/jobs/1/cancel", None),
    ],
)
def test_an_answer_has_the_fields_that_the_documentation_tells(
    stored_client: TestClient, model: type[Answer], method: str, path: str, body: Any
) -> None:
    answer = stored_client.request(method, path, **({} if body is None else {"json": body}))
    assert answer.is_success, answer.text
    model.model_validate_json(answer.content)
    route = path.partition("?")[0].replace("/1", "/{number}").replace("/e/", "/{event_id}/")
    told = stored_client.get("/openapi.json").json()["paths"][route][method.lower()]["responses"]
    schema = told[str(answer.status_code)]["content"]["application/json"]["schema"]
    assert schema == {"$ref": f"#/components/schemas/{model.__name__}"}


@pytest.mark.parametrize("path", ["/v1/spectra", "/v1/events/{event_id}/flag", "/v1/refits", "/v1/promotions"])
def test_every_route_with_a_body_tells_that_it_may_be_too_large(client: TestClient, path: str) -> None:
    assert "413" in client.get("/openapi.json").json()["paths"][path]["post"]["responses"]


@pytest.mark.parametrize("path", ["/v1/jobs/{number}", "/v1/events", "/v1/spectra/receipts"])
def test_a_refused_parameter_is_told_as_the_problem_that_it_is(client: TestClient, path: str) -> None:
    told = client.get("/openapi.json").json()["paths"][path]["get"]["responses"]["422"]
    assert list(told["content"]) == ["application/problem+json"]
