from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.factory import Factory
from tests.service.conftest import add_spectra, bearer, flat_spectra, like, served

REFIT = {"scope": "antenna", "since": "2014-01-01", "until": "2015-01-01", "reason": "test"}


@pytest.fixture
def filled(factory: Factory) -> Factory:
    """A service with an event of an antenna of each of its two stations, in each of two years."""
    rows = [(e, at, s, 0, "X") for e, at in (("a", 1.4e9), ("b", 1.43e9)) for s in ("CS001", "CS002")]
    add_spectra(factory, flat_spectra(*rows))
    return factory


@pytest.mark.parametrize(
    ("route", "body", "parts"),
    [
        ("refits", REFIT, 2),
        ("investigations", {"since": "2014-01-01", "until": "2016-01-01", "reason": "test"}, 4),
    ],
)
def test_an_order_that_could_never_fit_was_told_to_try_again(
    filled: Factory, route: str, body: dict[str, Any], parts: int
) -> None:
    with like(filled, max_open_parts=parts - 1) as small, served(small) as http:
        refused = http.post(f"/v1/{route}", json=body)
        assert (refused.status_code, refused.json()["type"]) == (413, "urn:lbacal:too_large")
        assert f"the order has {parts} parts" in refused.json()["detail"]
        assert f"and {parts - 1} fit (LBACAL_MAX_OPEN_PARTS): ask for single stations" in refused.json()["detail"]
        assert "retry-after" not in refused.headers
        assert http.get("/v1/jobs").json()["jobs"] == []
    with like(filled, max_open_parts=parts) as enough, served(enough) as http:
        assert http.post(f"/v1/{route}", json=body).status_code == 202
        full = http.post(f"/v1/{route}", json=body)
        assert (full.status_code, "retry-after" in full.headers) == (429, True), "there is room again once these ended"


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
