"""Spectra and events that are sent, stored, listed and flagged."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.factory import Factory

MHZ = [30.0, 45.0, 60.0, 80.0]


def spectrum(event: int = 0, **more: Any) -> dict[str, Any]:
    return {
        "event_id": f"e{event}", "time_utc": f"2014-03-{1 + event % 28:02d}T12:00:00.123456Z", "station": "CS001",
        "antenna": 0, "dipole": "X", "blocks": 100, "power": [1.0 + event, 2.0, 3.0, 4.0], **more,
    }  # fmt: skip


def batch(*spectra: dict[str, Any], mhz: list[float] | None = None) -> dict[str, Any]:
    return {"frequency_mhz": mhz or MHZ, "spectra": list(spectra)}


def count(client: TestClient) -> int:
    return sum(event["spectra"] for event in client.get("/v1/events").json()["events"])


def test_a_batch_is_stored_once_however_often_it_is_sent(client: TestClient) -> None:
    body = batch(spectrum(0), spectrum(0, dipole="Y"), spectrum(1))
    first = client.post("/v1/spectra", json=body)
    assert (first.status_code, first.json()) == (201, {"received": 3, "stored": 3, "duplicates": 0})
    again = client.post("/v1/spectra", json=body)
    assert (again.status_code, again.json()) == (200, {"received": 3, "stored": 0, "duplicates": 3})
    more = client.post("/v1/spectra", json=batch(spectrum(1), spectrum(2)))
    assert (more.status_code, more.json()) == (201, {"received": 2, "stored": 1, "duplicates": 1})
    assert count(client) == 4


def test_a_spectrum_twice_in_one_batch_counts_as_duplicate(client: TestClient) -> None:
    answer = client.post("/v1/spectra", json=batch(spectrum(0), spectrum(0)))
    assert (answer.status_code, answer.json()) == (201, {"received": 2, "stored": 1, "duplicates": 1})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"power": [1.0, 2.0, 3.0, 4.0000000000000009]}, "power"),
        ({"blocks": 99}, "blocks"),
        ({"time_utc": "2014-03-01T12:00:00.123459Z"}, "time"),
    ],
)
def test_another_spectrum_under_a_stored_key_is_a_conflict_that_names_the_row(
    client: TestClient, change: dict[str, Any], named: str
) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0)))
    answer = client.post("/v1/spectra", json=batch(spectrum(5), {**spectrum(0), **change}))
    assert answer.status_code == 409
    assert answer.headers["content-type"] == "application/problem+json"
    assert f"e0, CS001 antenna 0 X ({named})" in answer.json()["detail"]
    assert count(client) == 1, "nothing of a refused batch is stored"
    assert client.post("/v1/spectra", json=batch(spectrum(0), {**spectrum(0), **change})).status_code == 409


def test_a_time_off_by_a_microsecond_is_the_same_spectrum(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0)))
    again = client.post("/v1/spectra", json=batch(spectrum(0, time_utc="2014-03-01T13:00:00.123457+01:00")))
    assert again.json() == {"received": 1, "stored": 0, "duplicates": 1}


def test_covariates_belong_to_the_event_and_the_first_value_stays(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0, env={"temperature_c": 4.0, "rain_mm_h": None})))
    again = client.post("/v1/spectra", json=batch(spectrum(0, env={"temperature_c": 9.0, "rain_mm_h": 1.5})))
    assert again.status_code == 200
    assert client.get("/v1/events").json()["events"][0]["env"] == {"temperature_c": 4.0, "rain_mm_h": 1.5}


def post(client: TestClient, content: str | bytes) -> Any:
    return client.post("/v1/spectra", content=content, headers={"Content-Type": "application/json"})


@pytest.mark.long
def test_clients_who_add_different_covariates_to_the_same_events_all_keep_theirs(client: TestClient) -> None:
    """On PostgreSQL, where two of them write at once, 42 of 60 events lacked a name."""
    events, clients = 60, 8
    client.post("/v1/spectra", json=batch(*[spectrum(k) for k in range(events)]))
    together = Barrier(clients)

    def send(number: int) -> set[int]:
        together.wait()
        env = {f"from_{number}": float(number)}
        order = range(events) if number % 2 else reversed(range(events))
        return {client.post("/v1/spectra", json=batch(spectrum(k, env=env))).status_code for k in order}

    with ThreadPoolExecutor(clients) as pool:
        assert set.union(*pool.map(send, range(clients))) == {200}
    expected = {f"from_{number}": float(number) for number in range(clients)}
    assert [event["env"] for event in client.get("/v1/events").json()["events"]] == [expected] * events


def test_an_event_has_at_most_16_covariates_however_many_batches_bring_them(client: TestClient) -> None:
    def env(first: int, last: int) -> dict[str, float]:
        return {f"name_{k}": float(k) for k in range(first, last)}

    assert client.post("/v1/spectra", json=batch(spectrum(env=env(0, 10)))).status_code == 201
    refused = client.post("/v1/spectra", json=batch(spectrum(env=env(8, 17)), spectrum(antenna=1)))
    assert refused.status_code == 422
    assert "at most 16 names" in refused.json()["detail"]
    assert client.post("/v1/spectra", json=batch(spectrum(env=env(8, 16)))).status_code == 200
    assert client.get("/v1/events").json()["events"][0]["env"] == env(0, 16)


def test_an_event_stored_at_one_time_is_not_stored_at_another(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0)))
    later = client.post("/v1/spectra", json=batch(spectrum(0, antenna=1, time_utc="2016-03-01T12:00:00Z")))
    assert later.status_code == 409
    assert "event e0 is stored 63158400 s away" in later.json()["detail"]
    soon = client.post("/v1/spectra", json=batch(spectrum(0, antenna=1, time_utc="2014-03-01T12:00:01Z")))
    assert soon.status_code == 201, "stations read out within seconds of each other"


def post_file(client: TestClient, content: bytes) -> Any:
    return client.post("/v1/spectra", content=content, headers={"Content-Type": "application/x-hdf5"})


@pytest.mark.long
def test_a_spectra_file_is_stored_as_the_same_json_is(client: TestClient, file: bytes) -> None:
    rows = [spectrum(e, antenna=a, dipole=d) for e in range(2) for a in range(2) for d in "XY"]
    assert client.post("/v1/spectra", json=batch(*rows[:3])).status_code == 201
    first = post_file(client, file)
    assert (first.status_code, first.json()) == (201, {"received": 8, "stored": 5, "duplicates": 3})
    again = post_file(client, file)
    assert (again.status_code, again.json()) == (200, {"received": 8, "stored": 0, "duplicates": 8})
    assert client.post("/v1/spectra", json=batch(*rows)).json()["duplicates"] == 8
    assert [event["env"] for event in client.get("/v1/events").json()["events"]] == [
        {"temperature_c": 4.0}, {"temperature_c": 5.0},
    ]  # fmt: skip
    changed = batch({**rows[0], "blocks": 7}, spectrum(9))
    assert client.post("/v1/spectra", json=changed).status_code == 409


def receipts(client: TestClient, *bodies: bytes) -> list[str]:
    digests = ",".join(hashlib.sha256(body).hexdigest() for body in bodies)
    found: list[str] = client.get("/v1/spectra/receipts", params={"sha256": digests}).json()["stored"]
    return found


def test_a_body_that_was_stored_is_known_by_its_hash_and_not_read_again(
    client: TestClient, factory: Factory, file: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = json.dumps(batch(spectrum(5), spectrum(6))).encode()
    assert receipts(client, file, text) == []
    assert [post_file(client, file).status_code, post(client, text).status_code] == [201, 201]
    assert receipts(client, file, text, b"other") == sorted(hashlib.sha256(body).hexdigest() for body in (file, text))
    monkeypatch.setattr(type(factory.intake), "store", None)
    assert post_file(client, file).json() == {"received": 8, "stored": 0, "duplicates": 8}
    assert post(client, text).json() == {"received": 2, "stored": 0, "duplicates": 2}


def test_a_refused_body_is_not_taken_for_stored_when_it_is_sent_again(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0)))
    text = json.dumps(batch(spectrum(1), spectrum(0, blocks=7))).encode()
    assert [post(client, text).status_code for _ in range(2)] == [409, 409]
    assert receipts(client, text) == []


def test_writing_needs_a_key_with_the_scope(client: TestClient, factory: Any) -> None:
    body = batch(spectrum())
    del client.headers["Authorization"]
    nobody = client.post("/v1/spectra", json=body)
    assert (nobody.status_code, nobody.headers["www-authenticate"]) == (401, "Bearer")
    assert client.post("/v1/spectra", json=body, headers={"Authorization": "Bearer no"}).status_code == 401
    _, reader = factory.keys.create(("read", "refits:run"))
    assert client.post("/v1/spectra", json=body, headers={"Authorization": f"Bearer {reader}"}).status_code == 403
    number, writer = factory.keys.create(("spectra:write",))
    assert client.post("/v1/spectra", json=body, headers={"Authorization": f"Bearer {writer}"}).status_code == 201
    factory.keys.revoke(number)
    assert client.post("/v1/spectra", json=body, headers={"Authorization": f"Bearer {writer}"}).status_code == 401


def test_events_are_listed_in_pages_and_filtered(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(*[spectrum(k) for k in range(5)], spectrum(5, station="CS002")))
    first = client.get("/v1/events", params={"limit": 4}).json()
    rest = client.get("/v1/events", params={"limit": 4, "cursor": first["next"]}).json()
    assert [e["event_id"] for e in first["events"] + rest["events"]] == [f"e{k}" for k in range(6)]
    assert rest["next"] is None
    since = client.get("/v1/events", params={"since": "2014-03-02T12:00:00.123456Z", "until": "2014-03-04"}).json()
    assert [e["event_id"] for e in since["events"]] == ["e1", "e2"]
    assert [e["event_id"] for e in client.get("/v1/events?station=CS002").json()["events"]] == ["e5"]
    assert client.get("/v1/events?statoin=CS002").status_code == 422


def test_a_flag_is_set_found_and_cleared(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0), spectrum(1)))
    flagged = client.post("/v1/events/e1/flag", json={"flag": "thunderstorm", "reason": "lightning log"})
    assert flagged.json()["flag"] == "thunderstorm"
    assert [e["event_id"] for e in client.get("/v1/events?flag=thunderstorm").json()["events"]] == ["e1"]
    assert client.post("/v1/events/e1/flag", json={"flag": None, "reason": "log was wrong"}).json()["flag"] is None
    assert client.post("/v1/events/e9/flag", json={"flag": None, "reason": "x"}).status_code == 404
    assert client.post("/v1/events/e1/flag", json={"flag": "bad", "reason": " "}).status_code == 422


def test_four_clients_that_send_the_same_events_store_each_spectrum_once(client: TestClient) -> None:
    events = [batch(*[spectrum(k, antenna=a, dipole=d) for a in range(3) for d in "XY"]) for k in range(12)]

    def send(order: int) -> tuple[set[int], int]:
        bodies = events[order * 3 :] + events[: order * 3]
        answers = [client.post("/v1/spectra", json=body) for body in bodies for _ in range(2)]
        return {a.status_code for a in answers}, sum(a.json()["stored"] for a in answers)

    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(send, range(4)))
    assert all(statuses <= {200, 201} for statuses, _ in results)
    assert sum(stored for _, stored in results) == 12 * 6
    assert count(client) == 12 * 6
