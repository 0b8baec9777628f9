from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import text

from lbacal_core.curves.validity import Scope
from service.errors import UnavailableError
from service.factory import Factory
from service.storage.alarms import News
from service.storage.database import Database
from service.storage.processes import API, SCHEDULER, WORKER
from service.usecases import status
from service.usecases.status import Pulse, name_process


def see(factory: Factory, kind: str) -> str:
    name = name_process()
    with factory.database.write() as stores:
        stores.processes.see(name, kind, None)
    return name


def test_without_a_worker_the_service_is_not_ready_and_says_so(factory: Factory, client: TestClient) -> None:
    see(factory, SCHEDULER)
    answer = client.get("/readyz")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
    assert "no worker has lived for a minute" in answer.json()["detail"]
    see(factory, WORKER)
    assert client.get("/readyz").status_code == 200


def test_a_worker_that_has_been_silent_for_a_minute_is_dead(factory: Factory, client: TestClient) -> None:
    see(factory, WORKER)
    with factory.database.write() as stores:
        stores._connection.execute(text("UPDATE process SET seen_us = seen_us - 61000000"))
    assert client.get("/readyz").status_code == 503
    assert [(one["kind"], one["alive"]) for one in client.get("/v1/status").json()["processes"]] == [("worker", False)]


def test_a_full_disk_makes_it_not_ready(client: TestClient, factory: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    see(factory, WORKER)
    if factory.database.free_bytes is None:
        factory.database.write_failure = UnavailableError("the disk of the database is full")
    else:
        monkeypatch.setattr(status, "ROOM_BYTES", 10**18)
    answer = client.get("/readyz")
    assert (answer.status_code, "the disk of the database is full" in answer.text) == (503, True)
    see(factory, WORKER)
    monkeypatch.undo()
    assert client.get("/readyz").status_code == 200, "a write that succeeds says that there is room again"


def test_readiness_writes_nothing(client: TestClient, factory: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    see(factory, WORKER)
    assert client.get("/v1/jobs").status_code == 200  # the key is known from here on

    def refuse(_self: Database) -> Any:
        raise AssertionError

    monkeypatch.setattr(Database, "write", refuse)
    assert client.get("/readyz").status_code == 200
    assert client.get("/v1/status").json()["ready"]


def test_a_removed_sqlite_file_makes_it_not_ready(factory: Factory, client: TestClient, database_url: str) -> None:
    if database_url.startswith("postgresql"):
        pytest.skip("of SQLite")
    from pathlib import Path

    see(factory, WORKER)
    Path(database_url).unlink()
    answer = client.get("/readyz")
    assert (answer.status_code, database_url in answer.text) == (503, False)
    assert "was removed or replaced" in answer.text


def test_a_pulse_is_seen_while_the_work_runs_and_gone_after_it(factory: Factory) -> None:
    with Pulse(factory.database, API, "{}") as pulse:
        pulse.beat()
        with factory.database.read() as stores:
            (seen,) = stores.processes.all()
        assert (seen.name, seen.kind, seen.inputs, seen.is_alive) == (pulse.name, API, "{}", True)
    with factory.database.read() as stores:
        assert stores.processes.all() == []


def test_two_workers_of_one_host_and_number_have_two_names() -> None:
    assert name_process() != name_process()


def read(client: TestClient) -> dict[str, float]:
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    lines = (line.rpartition(" ") for line in answer.text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in lines}


def test_requests_are_counted_by_route_and_never_by_address(client: TestClient) -> None:
    for path in ("/v1/jobs/1", "/v1/jobs/2", "/v1/changes", "/secret/place"):
        client.get(path)
    told = read(client)
    assert told['lbacal_requests_total{method="GET",route="/v1/jobs/{number}",status="404"}'] == 2
    assert told['lbacal_requests_total{method="GET",route="/v1/changes",status="200"}'] == 1
    assert told['lbacal_requests_total{method="GET",route="none",status="404"}'] == 1
    assert told['lbacal_request_seconds_count{method="GET",route="/v1/jobs/{number}"}'] == 2
    assert told['lbacal_request_seconds_bucket{le="+Inf",method="GET",route="/v1/jobs/{number}"}'] == 2
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
    assert now['lbacal_alarms{kind="step",state="open"}'] == now['lbacal_parts{state="queued"}'] == 0
    assert (now['lbacal_processes_alive{kind="worker"}'], now["lbacal_ready"]) == (1, 1)
