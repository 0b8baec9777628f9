from __future__ import annotations

from fastapi.testclient import TestClient

from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.storage.alarms import News


def read(client: TestClient) -> dict[str, float]:
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    lines = (line.rpartition(" ") for line in answer.text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in lines}


def test_requests_are_counted_by_route_and_never_by_address(client: TestClient) -> None:
    for path in ("/v1/jobs/1", "/v1/jobs/2", "/v1/cuts", "/secret/place"):
        client.get(path)
    told = read(client)
    assert told['lbacal_requests_total{method="GET",route="/v1/jobs/{number}",status="404"}'] == 2
    assert told['lbacal_requests_total{method="GET",route="/v1/cuts",status="200"}'] == 1
    assert told['lbacal_requests_total{method="GET",route="none",status="404"}'] == 1
    assert told['lbacal_request_seconds_count{method="GET",route="/v1/jobs/{number}"}'] == 2
    assert not [name for name in told if "secret" in name or "jobs/1" in name]


def test_the_state_is_that_of_the_database(factory: Factory, client: TestClient) -> None:
    before = read(client)
    assert (before["lbacal_ready"], before["lbacal_events"], before["lbacal_gated_versions"]) == (0, 0, 0)
    assert "lbacal_newest_event_age_seconds" not in before
    with factory.database.write() as stores:
        stores.alarms.raise_alarm(News("misfit", Scope("CS001"), "", "it is wrong"), factory.clock())
        stores.processes.see("worker", "worker", None)
    now = read(client)
    assert now['lbacal_alarms{kind="misfit",state="open"}'] == 1
    assert now['lbacal_alarms{kind="step",state="open"}'] == 0
    assert (now['lbacal_processes_alive{kind="worker"}'], now["lbacal_ready"]) == (1, 1)
