from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal_core.curves.validity import Scope
from service.app import make_app
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.alarms import News
from service.storage.versions import Version
from service.wire.answer_models import (
    AlarmAnswer,
    AlarmsAnswer,
    AliveAnswer,
    Answer,
    ChangesAnswer,
    DiffAnswer,
    DriftAnswer,
    EventAnswer,
    EventsAnswer,
    InEffectAnswer,
    JobAnswer,
    JobsAnswer,
    PromotionAnswer,
    ReceiptAnswer,
    ReceiptsAnswer,
    RefitAnswer,
    StatusAnswer,
    VersionsAnswer,
    WholeVersionAnswer,
)
from tests.service.test_worker import work

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


@pytest.mark.long
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


def test_an_alarm_has_the_fields_that_the_documentation_tells(factory: Factory, client: TestClient) -> None:
    news = News("step", Scope("CS001", 0, "X"), "", "it jumped", {"size": 0.03}, 1_400_000_000_000_000, 10**10)
    with factory.database.write() as stores:
        number = stores.alarms.raise_alarm(news, factory.clock())
    AlarmsAnswer.model_validate_json(client.get("/v1/alarms?limit=1").content)
    known = client.post(f"/v1/alarms/{number}/acknowledgement", json={"reason": "test"})
    AlarmAnswer.model_validate_json(known.content)
    told = client.get("/openapi.json").json()["paths"]
    assert told["/v1/alarms"]["get"]["responses"]["200"]["content"]["application/json"]["schema"] == {
        "$ref": "#/components/schemas/AlarmsAnswer"
    }


def test_drift_has_the_fields_that_the_documentation_tells_when_something_was_found(station: Factory) -> None:
    look_for_due_work(station)
    work(station)
    with TestClient(make_app(station)) as client:
        for query in ("", "?station=CS002", "?station=CS002&antenna=2&dipole=Y"):
            DriftAnswer.model_validate_json(client.get(f"/v1/drift{query}").content)


PATH = "station=CS001&antenna=0&dipole=X"
A, B = "{path}", "{other}"


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "method", "path", "body"),
    [
        (AliveAnswer, "GET", "/healthz", None),
        (StatusAnswer, "GET", "/v1/status", None),
        (InEffectAnswer, "GET", f"/v1/calibrations/effective?at=2014-06-01&{PATH}", None),
        (InEffectAnswer, "GET", "/v1/calibrations/effective?at=2014-06-01&station=CS001", None),
        (VersionsAnswer, "GET", "/v1/calibrations?limit=2", None),
        (WholeVersionAnswer, "GET", f"/v1/calibrations/{A}", None),
        (DiffAnswer, "GET", f"/v1/calibrations/{A}/diff/{B}", None),
        (ChangesAnswer, "POST", "/v1/promotions?dry_run=true", "promotion"),
        (PromotionAnswer, "POST", "/v1/promotions", "promotion"),
        (DriftAnswer, "GET", f"/v1/drift?{PATH}", None),
    ],
)
def test_an_answer_about_calibrations_has_the_fields_that_the_documentation_tells(
    client: TestClient, stored: dict[str, Version], model: type[Answer], method: str, path: str, body: Any
) -> None:
    promotion = {"calibration": stored["path"].id, "valid_from": "2014-01-01", "reason": "test"}
    assert client.post("/v1/promotions", json=promotion).status_code == 201
    asked = path.format(**{name: version.id for name, version in stored.items()})
    answer = client.request(method, asked, **({"json": promotion} if body else {}))
    assert answer.is_success, answer.text
    model.model_validate_json(answer.content)
    route = path.partition("?")[0].replace(f"{A}/diff/{B}", "{first}/diff/{second}").replace(A, "{version_id}")
    told = client.get("/openapi.json").json()["paths"][route][method.lower()]["responses"]
    schema = told[str(answer.status_code)]["content"]["application/json"]["schema"]
    assert schema == {"$ref": f"#/components/schemas/{model.__name__}"}


def test_every_route_tells_what_it_answers_and_how_a_key_is_given(client: TestClient) -> None:
    """All answer schemas were empty, and there was no Authorize button."""
    told = client.get("/openapi.json").json()
    assert told["components"]["securitySchemes"]["key"]["scheme"] == "bearer"
    for path, methods in told["paths"].items():
        for method, route in methods.items():
            good = [response for status, response in route["responses"].items() if status.startswith("2")]
            assert good, (method, path)
            for response in good:
                kinds = response["content"]
                assert kinds.get("application/json", {"schema": True})["schema"], (method, path)
            is_open = path in ("/healthz", "/readyz")
            assert route.get("security", []) == ([] if is_open else [{"key": []}]), (method, path)
            assert "406" in route["responses"], (method, path)


@pytest.mark.parametrize("path", ["/v1/spectra", "/v1/events/{event_id}/flag", "/v1/refits", "/v1/promotions"])
def test_every_route_with_a_body_tells_that_it_may_be_too_large(client: TestClient, path: str) -> None:
    assert "413" in client.get("/openapi.json").json()["paths"][path]["post"]["responses"]


@pytest.mark.parametrize("path", ["/v1/jobs/{number}", "/v1/events", "/v1/spectra/receipts"])
def test_a_refused_parameter_is_told_as_the_problem_that_it_is(client: TestClient, path: str) -> None:
    told = client.get("/openapi.json").json()["paths"][path]["get"]["responses"]["422"]
    assert list(told["content"]) == ["application/problem+json"]
