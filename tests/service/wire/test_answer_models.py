from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections import Counter
from typing import Any

import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, Phase, given, settings, strategies
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from lbacal_core.curves.validity import Scope
from service.app import GZIP_FROM, make_app
from service.factory import Factory
from service.page.render import load_assets
from service.storage.alarms import News
from service.storage.versions import Version
from service.wire import answer_models as told_by
from tests.service.conftest import night

ROW = {
    "event_id": "e", "time_utc": "2014-03-01", "station": "CS001", "antenna": 0, "dipole": "X", "blocks": 100,
    "power": [1.0, 2.0, 3.0, 4.0], "env": {"rain_mm_h": 0.5},
}  # fmt: skip
BODY = json.dumps({"frequency_mhz": [30.0, 45.0, 60.0, 80.0], "spectra": [ROW]}).encode()
REFIT = {"scope": "station", "since": "2014-01-01", "until": "2015-01-01", "reason": "test"}


PROMOTION = {"valid_from": "2014-01-01", "reason": "test"}
PATH = "station=CS001&antenna=0&dipole=X"
A, B = "{path}", "{other}"


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "method", "path", "body"),
    [
        (told_by.ReceiptAnswer, "POST", "/v1/spectra", json.loads(BODY)),
        (told_by.ReceiptsAnswer, "GET", f"/v1/spectra/receipts?sha256={hashlib.sha256(BODY).hexdigest()}", None),
        (told_by.EventsAnswer, "GET", "/v1/events?limit=1", None),
        (told_by.EventAnswer, "POST", "/v1/events/e/flag", {"flag": "thunder", "reason": "test"}),
        (told_by.RefitAnswer, "POST", "/v1/refits", REFIT),
        (told_by.JobAnswer, "GET", "/v1/jobs/1", None),
        (told_by.JobsAnswer, "GET", "/v1/jobs?limit=1", None),
        (told_by.JobAnswer, "POST", "/v1/jobs/1/cancel", None),
        (told_by.AliveAnswer, "GET", "/healthz", None),
        (told_by.StatusAnswer, "GET", "/v1/status", None),
        (told_by.InEffectAnswer, "GET", f"/v1/calibrations/effective?at=2014-06-01&{PATH}", None),
        (told_by.InEffectAnswer, "GET", "/v1/calibrations/effective?at=2014-06-01&station=CS001", None),
        (told_by.VersionsAnswer, "GET", "/v1/calibrations?limit=2", None),
        (told_by.WholeVersionAnswer, "GET", f"/v1/calibrations/{A}", None),
        (told_by.DiffAnswer, "GET", f"/v1/calibrations/{A}/diff/{B}", None),
        (told_by.ChangesAnswer, "POST", "/v1/promotions?dry_run=true", PROMOTION),
        (told_by.PromotionAnswer, "POST", "/v1/promotions", PROMOTION),
        (told_by.DriftAnswer, "GET", f"/v1/drift?{PATH}", None),
    ],
)
def test_an_answer_has_the_fields_that_the_documentation_tells(
    client: TestClient, stored: dict[str, Version], model: type[told_by.Answer], method: str, path: str, body: Any
) -> None:
    client.post("/v1/spectra", content=BODY, headers={"Content-Type": "application/json"})
    client.post("/v1/refits", json=REFIT)
    promotion = {**PROMOTION, "calibration": stored["path"].id}
    assert client.post("/v1/promotions", json=promotion).status_code == 201
    asked = path.format(**{name: version.id for name, version in stored.items()})
    sent = {} if body is None else {"json": promotion if body is PROMOTION else body}
    answer = client.request(method, asked, **sent)
    assert answer.is_success, answer.text
    model.model_validate_json(answer.content)
    route = path.partition("?")[0]
    for one, name in (
        (f"{A}/diff/{B}", "{first}/diff/{second}"), (A, "{version_id}"), ("/jobs/1", "/jobs/{number}"),
        ("/e/", "/{event_id}/"),
    ):  # fmt: skip
        route = route.replace(one, name)
    told = client.get("/openapi.json").json()["paths"][route][method.lower()]["responses"]
    schema = told[str(answer.status_code)]["content"]["application/json"]["schema"]
    assert schema == {"$ref": f"#/components/schemas/{model.__name__}"}


def test_an_alarm_has_the_fields_that_the_documentation_tells(factory: Factory, client: TestClient) -> None:
    news = News("step", Scope("CS001", 0, "X"), "", "it jumped", {"size": 0.03}, 1_400_000_000_000_000, 10**10)
    with factory.database.write() as stores:
        number = stores.alarms.raise_alarm(news, factory.clock())
    told_by.AlarmsAnswer.model_validate_json(client.get("/v1/alarms?limit=1").content)
    known = client.post(f"/v1/alarms/{number}/acknowledgement", json={"reason": "test"})
    told_by.AlarmAnswer.model_validate_json(known.content)
    told = client.get("/openapi.json").json()["paths"]
    assert told["/v1/alarms"]["get"]["responses"]["200"]["content"]["application/json"]["schema"] == {
        "$ref": "#/components/schemas/AlarmsAnswer"
    }


@pytest.mark.long
def test_drift_has_the_fields_that_the_documentation_tells_when_something_was_found(station: Factory) -> None:
    night(station)
    with TestClient(make_app(station)) as client:
        for query in ("", "?station=CS002", "?station=CS002&antenna=2&dipole=Y"):
            told_by.DriftAnswer.model_validate_json(client.get(f"/v1/drift{query}").content)


def test_every_route_tells_what_it_answers_what_it_refuses_and_how_a_key_is_given(client: TestClient) -> None:
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
    for path in ("/v1/spectra", "/v1/events/{event_id}/flag", "/v1/refits", "/v1/promotions"):
        assert "413" in told["paths"][path]["post"]["responses"], "a body may be too large"
    for path in ("/v1/jobs/{number}", "/v1/events", "/v1/spectra/receipts"):
        refused = told["paths"][path]["get"]["responses"]["422"]
        assert list(refused["content"]) == ["application/problem+json"], "a parameter may be refused"


EXAMPLES = 5
"""Requests to each route, made up from its schema: 90 to 100 in all."""
CONFORMANCE = [
    content_type_conformance, response_headers_conformance, response_schema_conformance, status_code_conformance,
]  # fmt: skip


def test_a_large_answer_is_compressed_for_those_who_accept_that(client: TestClient) -> None:
    large = "/openapi.json"
    small = min(load_assets().values(), key=lambda asset: len(asset.content))
    packed, plain = client.get(large), client.get(large, headers={"Accept-Encoding": "identity"})
    assert len(plain.content) > GZIP_FROM
    assert (packed.headers.get("content-encoding"), plain.headers.get("content-encoding")) == ("gzip", None)
    assert packed.content == plain.content
    assert 2 * int(packed.headers["content-length"]) < int(plain.headers["content-length"])
    assert "accept-encoding" in plain.headers["vary"].lower()
    assert "content-encoding" not in client.get(small.url).headers


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize("scope", ["admin", "read"])
def test_every_route_answers_what_its_schema_allows_as_its_schema_says(
    factory: Factory, stored: dict[str, Version], scope: str
) -> None:
    _, key = factory.keys.create((scope,))
    known = {"version_id": stored["path"].id, "first": stored["path"].id, "second": stored["other"].id}
    statuses: Counter[int] = Counter()
    for found in schemathesis.openapi.from_asgi("/openapi.json", make_app(factory)).get_all_operations():
        operation = found.ok()

        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy(), is_known=strategies.booleans())
        def ask(case: schemathesis.Case, is_known: bool) -> None:
            if is_known:
                case.path_parameters.update({name: known[name] for name in case.path_parameters if name in known})
            answer = case.call(headers={"Authorization": f"Bearer {key}"})
            case.validate_response(answer, checks=CONFORMANCE)
            # nobody works here, and readiness says so
            assert answer.status_code < 500 or (case.path, answer.status_code) == ("/readyz", 503)
            statuses[answer.status_code] += 1

        ask()
    assert statuses[200] > 0
    assert (statuses[403] > 0) == (scope == "read")
    assert statuses[401] == 0


def test_an_api_that_answers_loads_nothing_of_what_computes() -> None:
    code = "import sys, service.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "service.usecases.calibrations" in loaded
    computing = {"scipy.special", "healpy", "lbacal_core.discovery", "lbacal_core.audit", "lbacal_core.calibration.fit"}
    assert loaded & computing == set()
