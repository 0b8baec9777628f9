from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.factory import Factory
from service.worker import Worker

WINDOW = {"since": "2014-01-01", "until": "2016-01-01", "reason": "test"}
ROUTE = "/v1/investigations"


@pytest.fixture
def asked(station: Factory) -> Iterator[TestClient]:
    """A client that may run jobs, of a service that holds two years of one station."""
    _, key = station.keys.create(["read", "refits:run"], None)
    with TestClient(make_app(station), headers={"Authorization": f"Bearer {key}"}) as client:
        yield client


def run(factory: Factory, client: TestClient, **body: Any) -> dict[str, Any]:
    """Ask, work, and return the job."""
    response = client.post(ROUTE, json=WINDOW | body)
    assert response.status_code == 202, response.text
    Worker(factory).run(threading.Event(), until_idle=True)
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
    assert "C changes with the date, so it is not adopted: windows are" in page.text

    _, admin = station.keys.create(["admin"], None)
    asked.headers["Authorization"] = f"Bearer {admin}"
    body = {"finding": 0, "reason": "a new amplifier", "promote": True}
    for dry_run in (True, False):  # C of the year would be that before the step, 7 % off behind it
        refused = asked.post(f"{ROUTE}/{by_year['2015']['id']}/adoption", json=body, params={"dry_run": dry_run})
        assert (refused.status_code, refused.headers["content-type"]) == (422, "application/problem+json")
        assert "body.finding: expected a cause that does not follow the date" in refused.json()["detail"]
        assert "by `lbacal cuts`" in refused.json()["detail"]
    assert asked.get("/v1/models").json()["models"] == []


@pytest.mark.long
def test_the_same_inputs_are_investigated_once_and_named_alike(
    station: Factory, asked: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = {"since": "2014-01-01", "until": "2014-04-01", "station": "CS002"}
    first = run(station, asked, **body)
    made = asked.get(f"{ROUTE}/{first['results'][0]}").json()
    monkeypatch.setattr(type(station.investigations), "_investigate", None)  # a second search would fail
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
