from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal_core.causes.model import AdoptedCause, Model
from service.factory import Factory
from service.storage.models import ADOPTED, ModelChange
from service.usecases.orders import name_inputs
from tests.service.conftest import add_spectra, bearer, flat_spectra, like, served, work

REFIT = {"scope": "antenna", "since": "2014-01-01", "until": "2015-01-01", "reason": "test"}


@pytest.fixture
def filled(factory: Factory) -> Factory:
    """A service with an event of an antenna of each of its two stations, in each of two years."""
    rows = [(e, at, s, 0, "X") for e, at in (("a", 1.4e9), ("b", 1.43e9)) for s in ("CS001", "CS002")]
    add_spectra(factory, flat_spectra(*rows))
    return factory


@pytest.mark.parametrize(
    ("route", "body", "parts"),
    [("refits", REFIT, 2), ("investigations", {"since": "2014-01-01", "until": "2016-01-01", "reason": "test"}, 4)],
)
def test_an_order_that_could_never_fit_was_told_to_try_again(
    filled: Factory, route: str, body: dict[str, Any], parts: int
) -> None:
    with like(filled, max_open_parts=parts - 1) as small, served(small) as http:
        assert http.post(f"/v1/{route}", json=body).status_code == 202
        full = http.post(f"/v1/{route}", json=body)
        assert (full.status_code, "retry-after" in full.headers) == (429, True), "there is room again once these ended"
        assert http.get("/v1/status").json()["parts"]["queued"] == parts


def test_a_large_order_and_a_small_one_take_turns(filled: Factory, client: TestClient) -> None:
    body = {"since": "2014-01-01", "until": "2016-01-01", "reason": "test"}
    large = client.post("/v1/investigations", json=body).json()["job"]
    small = client.post("/v1/investigations", json={**body, "station": "CS002", "until": "2015-01-01"}).json()["job"]
    with filled.database.write() as stores:
        inputs = name_inputs(filled.simulation).text
        taken = [stores.jobs.claim("me", lease_us=10**9, inputs=inputs) for _ in range(5)]
    assert [part and part.job for part in taken] == [large, small, large, large, large]


def test_jobs_are_listed_newest_first_and_stopped_once(filled: Factory, client: TestClient) -> None:
    first, second = (client.post("/v1/refits", json=REFIT).json()["job"] for _ in range(2))
    page = client.get("/v1/jobs", params={"limit": 1}).json()
    assert [job["job"] for job in page["jobs"]] == [second]
    rest = client.get("/v1/jobs", params={"cursor": page["next"]}).json()
    assert ([job["job"] for job in rest["jobs"]], rest["next"]) == ([first], None)
    job = client.get(f"/v1/jobs/{first}").json()
    assert (job["kind"], job["state"], job["progress"], job["request"]["scope"]) == ("refit", "queued", 0.0, "antenna")
    assert client.post(f"/v1/jobs/{first}/cancel", json={"reason": ""}).status_code == 422
    stopped = client.post(f"/v1/jobs/{first}/cancel", json={"reason": "a mistake"}).json()
    # a cancelled job kept neither who nor why
    assert (stopped["state"], stopped["error"]) == ("cancelled", "cancelled by key 1: a mistake")
    with filled.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE job_part SET state = 'done', ended_us = 1")
    refused = client.post(f"/v1/jobs/{second}/cancel")
    assert (refused.status_code, refused.json()["title"]) == (409, "Conflict")
    assert client.get(f"/v1/jobs/{second}").json()["state"] == "done"
    assert client.get("/v1/jobs/99").status_code == 404
    assert client.post("/v1/refits", json=REFIT, headers=bearer(filled, "refits:run")).status_code == 202


WINDOW = {"since": "2014-01-01", "until": "2016-01-01", "reason": "test"}
ROUTE = "/v1/investigations"


@pytest.fixture
def asked(station: Factory) -> Iterator[TestClient]:
    """A client that may run jobs, of a service that holds two years of one station."""
    with served(station, "read", "refits:run") as client:
        yield client


def run(factory: Factory, client: TestClient, **body: Any) -> dict[str, Any]:
    """Ask, work, and return the job."""
    response = client.post(ROUTE, json=WINDOW | body)
    assert response.status_code == 202, response.text
    work(factory)
    job: dict[str, Any] = client.get(f"/v1/jobs/{response.json()['job']}").json()
    assert job["state"] == "done", job
    return job


@pytest.mark.long
def test_a_planted_step_is_found_in_its_year_and_the_report_is_kept(station: Factory, asked: TestClient) -> None:
    job = run(station, asked)
    assert job["kind"] == "investigation"
    assert job["calibrations"] == []
    reports = [asked.get(f"{ROUTE}/{name}").json() for name in job["results"]]
    by_year = {one["since"][:4]: one for one in reports}
    assert set(by_year) == {"2014", "2015"}
    first = by_year["2015"]["report"]["findings"][0]
    assert (first["cause"], first["where"]["antennas"]) == ("gain_step", [2])
    assert by_year["2015"]["findings"][0] == "gain_step"
    assert "gain_step" not in by_year["2014"]["findings"]
    assert by_year["2015"]["inputs"]["model_version"] == by_year["2014"]["inputs"]["model_version"]

    listed = asked.get(ROUTE, params={"limit": 1}).json()
    assert len(listed["investigations"]) == 1
    rest = asked.get(ROUTE, params={"cursor": listed["next"]}).json()["investigations"]
    assert {listed["investigations"][0]["id"], rest[0]["id"]} == set(job["results"])

    page = asked.get(f"/investigations/{by_year['2015']['id']}")
    assert page.status_code == 200
    assert "gain_step" in page.text
    assert "C changes with the date: it is no cause to adopt but a" in page.text

    asked.headers.update(bearer(station, "admin"))
    body = {"finding": 0, "reason": "a new amplifier", "promote": True}
    for dry_run in (True, False):  # C of the year would be that before the step, 7 % off behind it
        refused = asked.post(f"{ROUTE}/{by_year['2015']['id']}/adoption", json=body, params={"dry_run": dry_run})
        assert (refused.status_code, refused.headers["content-type"]) == (422, "application/problem+json")
        assert "body.finding: expected a cause that does not follow the date" in refused.json()["detail"]
        assert "put it in force by `lbacal changes`" in refused.json()["detail"]
    assert asked.get("/v1/models").json()["models"] == []


@pytest.mark.long
def test_the_same_inputs_are_investigated_once_and_named_alike(
    station: Factory, asked: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = {"since": "2014-01-01", "until": "2014-04-01", "station": "CS002"}
    first = run(station, asked, **body)
    made = asked.get(f"{ROUTE}/{first['results'][0]}").json()
    monkeypatch.setattr("service.usecases.investigations._investigate", None)  # a second search would fail
    again = run(station, asked, **body, reason="once more")
    assert again["results"] == first["results"]
    assert asked.get(f"{ROUTE}/{again['results'][0]}").json() == made
    assert made["reason"] == "test"


@pytest.mark.parametrize(
    ("body", "status", "message"),
    [
        ({"until": "2013-01-01"}, 422, "an instant after since"),
        ({"since": "2012-01-01", "until": "2013-01-01"}, 409, "no usable spectra"),
        ({"station": "CS999"}, 422, "CS999"),
        ({"finding": 1}, 422, "finding"),
    ],
)
def test_what_cannot_be_investigated_is_refused(
    asked: TestClient, body: dict[str, Any], status: int, message: str
) -> None:
    response = asked.post(ROUTE, json=WINDOW | body)
    assert response.status_code == status
    assert message in response.text


def test_an_unknown_investigation_is_404_and_asking_needs_a_key(asked: TestClient) -> None:
    assert asked.get(f"{ROUTE}/{'0' * 64}").status_code == 404
    assert asked.get(ROUTE, params={"cursor": "0" * 64}).status_code == 404
    assert asked.post(ROUTE, json=WINDOW, headers={"Authorization": ""}).status_code == 401


SWAP = AdoptedCause("dipole_swap", "CS001", "station", 0.3, 0.02, since_unix=1_388_534_400)


def adopt(factory: Factory) -> Model:
    """A model as a ledger has it, after an adoption."""
    model, plain = Model((SWAP,)), Model()
    with factory.database.write() as stores:
        stores.models.put(model, plain)
        stores.models.change(
            ModelChange(
                0, "CS001", ADOPTED, model.id, plain.id, model.id, 1_388_534_400_000_000, None, None, None, None, {},
                (12.0, 3.0), factory.clock(), "somebody", "the cables were exchanged",
            )
        )  # fmt: skip
    return model


def test_a_model_is_listed_and_withdrawn_once(factory: Factory, client: TestClient) -> None:
    assert client.get("/v1/models").json() == {"models": [], "next": None}
    model = adopt(factory)
    (line,) = client.get("/v1/models").json()["models"]
    assert (line["id"], line["station"], line["act"], line["in_effect"]) == (model.id, "CS001", "adopted", True)
    assert (line["promise"], line["by"], line["reason"]) == ([12.0, 3.0], "somebody", "the cables were exchanged")
    assert (line["causes"][0]["cause"], line["causes"][0]["since"]) == ("dipole_swap", "2014-01-01T00:00:00Z")
    route = f"/v1/models/{model.id[:10]}/withdrawal"
    assert client.post(route, json={}).status_code == 422
    gone = client.post(route, json={"reason": "they were right"})
    assert (gone.status_code, gone.json()) == (202, {"model": Model().id, "jobs": []})
    assert client.post(route, json={"reason": "again"}).status_code == 409
    lines = client.get("/v1/models").json()["models"]
    assert [(one["act"], one["in_effect"], len(one["causes"])) for one in lines] == [
        ("withdrawn", True, 0), ("adopted", False, 1),
    ]  # fmt: skip
    page = client.get("/v1/models", params={"limit": 1}).json()
    rest = client.get("/v1/models", params={"cursor": page["next"]}).json()["models"]
    assert [one["act"] for one in rest] == ["adopted"]


def test_an_unknown_model_is_not_withdrawn(factory: Factory, client: TestClient) -> None:
    adopt(factory)
    assert client.post(f"/v1/models/{'0' * 64}/withdrawal", json={"reason": "x"}).status_code == 404
    assert client.get("/v1/models").json()["models"][0]["in_effect"]
