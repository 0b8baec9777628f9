"""Spectra and events that are sent, stored, listed and flagged."""

from __future__ import annotations

import hashlib
import io
import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import h5py
import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal_core.instrument.instrument import Instrument
from service.config import Settings
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.spectra import Window
from service.wire.hdf5_child import write_example
from tests.service.conftest import MHZ, Clock, bearer, served


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
    twice = client.post("/v1/spectra", json=batch(spectrum(3), spectrum(3)))
    assert (twice.status_code, twice.json()) == (201, {"received": 2, "stored": 1, "duplicates": 1})
    off_by_a_microsecond = spectrum(0, time_utc="2014-03-01T13:00:00.123457+01:00")
    assert client.post("/v1/spectra", json=batch(off_by_a_microsecond)).json()["duplicates"] == 1


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


def test_covariates_belong_to_the_event_and_the_first_value_stays(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum(0, env={"temperature_c": 4.0, "rain_mm_h": None})))
    again = client.post("/v1/spectra", json=batch(spectrum(0, env={"temperature_c": 9.0, "rain_mm_h": 1.5})))
    assert again.status_code == 200
    assert client.get("/v1/events").json()["events"][0]["env"] == {"temperature_c": 4.0, "rain_mm_h": 1.5}
    assert again.json()["covariates"] == 1, "one became known"
    (sentence,) = again.json()["warnings"]
    assert sentence.startswith("temperature_c of 1 event is stored with another value, and what is stored stays: e0; ")
    env = {"temperature_c": 4.0, "rain_mm_h": 1.5}
    assert client.post("/v1/spectra", json=batch(spectrum(0, env=env), spectrum(1, env=env))).json() == {
        "received": 2, "stored": 1, "duplicates": 1,
    }, "those of a new event, and those that are stored, are no news"  # fmt: skip


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


def test_a_spectra_file_is_stored_as_the_same_json_is(client: TestClient, file: bytes) -> None:
    rows = [spectrum(e, antenna=a, dipole=d) for e in range(2) for a in range(2) for d in "XY"]
    assert client.post("/v1/spectra", json=batch(*rows[:3])).status_code == 201
    first = post_file(client, file)
    answered = {"received": 8, "stored": 5, "duplicates": 3, "covariates": 1}
    assert (first.status_code, first.json()) == (201, answered), "of e0 no temperature was known"
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
    reader, writer = bearer(factory, "read", "refits:run"), bearer(factory, "spectra:write")
    assert client.post("/v1/spectra", json=body, headers=reader).status_code == 403
    assert client.post("/v1/spectra", json=body, headers=writer).status_code == 201
    factory.keys.revoke(factory.database.look(lambda stores: stores.keys.all())[-1].number)
    assert client.post("/v1/spectra", json=body, headers=writer).status_code == 401


def test_events_are_listed_in_pages_and_filtered(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(*[spectrum(k) for k in range(5)], spectrum(5, station="CS002")))
    first = client.get("/v1/events", params={"limit": 4}).json()
    rest = client.get("/v1/events", params={"limit": 4, "cursor": first["next"]}).json()
    assert [e["event_id"] for e in first["events"] + rest["events"]] == [f"e{k}" for k in range(6)]
    assert rest["next"] is None
    since = client.get("/v1/events", params={"since": "2014-03-02T12:00:00.123456Z", "until": "2014-03-04"}).json()
    assert [e["event_id"] for e in since["events"]] == ["e1", "e2"]
    for path in ("/v1/events", "/v1/changes"):
        answer = client.get(path, params={"since": "2014-03-04", "until": "2014-03-02"})
        assert (answer.status_code, "until: expected an instant after since" in answer.text) == (422, True)
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


def test_spectra_of_an_antenna_that_is_not_on_record_then_are_refused(
    database_url: str, clock: Clock, instrument: Instrument, tmp_path: Path
) -> None:
    content = instrument.as_dict()
    for antenna, interval in enumerate(({"since": "2014-06-01"}, {"until": "2014-06-01"}, {})):
        content["antennas"][antenna] |= interval
    (tmp_path / "I.json").write_text(json.dumps(content))
    factory = Factory(Settings(database_url=database_url, instrument=str(tmp_path / "I.json")), clock)
    with served(factory) as client:
        answers = {
            (antenna, month): client.post("/v1/spectra", json=batch(spectrum(month, antenna=antenna, time_utc=time)))
            for antenna in range(3)
            for month, time in ((5, "2014-05-31T23:59:59Z"), (6, "2014-06-01T00:00:00Z"))
        }
    factory.database.close()
    assert {key: answer.status_code for key, answer in answers.items()} == {
        (0, 5): 422, (0, 6): 201, (1, 5): 201, (1, 6): 422, (2, 5): 201, (2, 6): 201,
    }  # fmt: skip
    assert "a time at which CS001 antenna 0 is on record, found 2014-05-31T23:59:59Z" in answers[0, 5].text


MISSING = object()
BAD: dict[str, Any] = {
    "another grid": batch(spectrum(), mhz=[30.0, 45.0, 60.0, 81.0]),
    "fewer channels": batch(spectrum(power=[1.0, 2.0]), mhz=[30.0, 45.0]),
    "unknown station": batch(spectrum(station="CS003")),
    "negative antenna": batch(spectrum(antenna=-1)),
    "huge antenna": batch(spectrum(antenna=2**70)),
    "zero power": batch(spectrum(power=[1.0, 0.0, 3.0, 4.0])),
    "null power": batch(spectrum(power=[1.0, None, 3.0, 4.0])),
    "power as text": batch(spectrum(power=[1.0, "2.0", 3.0, 4.0])),
    "power as bool": batch(spectrum(power=[1.0, True, 3.0, 4.0])),
    "no blocks": batch(spectrum(blocks=0)),
    "half a block": batch(spectrum(blocks=1.5)),
    "before 2009": batch(spectrum(time_utc="2008-12-31T23:59:59Z")),
    "the future": batch(spectrum(time_utc="2020-01-02T01:00:00Z")),
    "a number": batch(spectrum(time_utc=1.4e9)),
    "no event": batch(spectrum(event_id="")),
    "control character": batch(spectrum(event_id="a\x00b")),
    "no spectra": batch(),
    "a list": [spectrum()],
    "a covariate as text": batch(spectrum(env={"temperature_c": "cold"})),
    "another resistance": {**batch(spectrum()), "resistance_ohm": 75.0},
    "an event of two years": batch(spectrum(), spectrum(antenna=1, time_utc="2016-03-01T12:00:00Z")),
    "a slash in an event": batch(spectrum(event_id="2014/17")),
    "an event called .": batch(spectrum(event_id=".")),
    "an event called ..": batch(spectrum(event_id="..")),
    "a temperature in Kelvin": batch(spectrum(env={"temperature_c": 283.15})),
    "a covariate with a space": batch(spectrum(env={"wind speed": 1.0})),
    "17 covariates": batch(spectrum(env={f"name_{k}": 1.0 for k in range(17)})),
    "17 covariates of one event": batch(
        spectrum(env={f"name_{k}": 1.0 for k in range(9)}),
        spectrum(antenna=1, env={f"name_{k}": 1.0 for k in range(8, 17)}),
    ),
    "more than 64 covariates in a batch": batch(*[spectrum(k, env={f"name_{k}": 1.0}) for k in range(66)]),
}


def test_a_bad_batch_is_refused_whole(client: TestClient) -> None:
    for name, bad in BAD.items():
        is_batch = isinstance(bad, dict) and bad["spectra"]
        answer = client.post(
            "/v1/spectra", json={**bad, "spectra": [spectrum(7), *bad["spectra"]]} if is_batch else bad
        )
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:lbacal:bad_input"), (name, answer.text)
        assert count(client) == 0, name


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("2.0", "NaN", "found NaN"),
        ("2.0", "Infinity", "found Infinity"),
        ("2.0", "-Infinity", "found -Infinity"),
        ("2.0", "1e999", "power[1]: expected a finite number"),
        ("[30.0, 45.0, 60.0, 80.0]", "[NaN, NaN, NaN, NaN]", "numbers are finite, found NaN"),
        ("[30.0, 45.0, 60.0, 80.0]", "[1e999, 45.0, 60.0, 80.0]", r"frequency_mhz[0]: expected a finite number"),
        ('"blocks": 100', '"blocks": 100, "blocks": 50', "the field 'blocks' twice in one object"),
    ],
)
def test_what_json_says_twice_or_not_at_all_is_refused(client: TestClient, old: str, new: str, named: str) -> None:
    text = json.dumps(batch(spectrum()))
    assert old in text
    answer = post(client, text.replace(old, new))
    assert answer.status_code in (400, 422), answer.text
    assert named in answer.json()["detail"]
    assert count(client) == 0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"dipole": "x"}, "body.spectra[1].dipole: expected one of X, Y, found 'x'"),
        ({"power": [1.0, -3.0, 3.0, 4.0]}, "body.spectra[1].power[1]: expected a number > 0, found -3.0"),
        *[
            (
                {"power": [1.0, 2.0, bad, 4.0]},
                f"body.spectra[1].power: expected a power from 1e-100 to 1e+100, found {bad}",
            )
            for bad in (1e308, 5e-324)
        ],
        ({"antenna": 77}, "body.spectra[1].antenna: expected an antenna of CS001 (0 to 2), found 77"),
        ({"antena": 1}, "body.spectra[1].antena: expected no field of this name, found 1"),
        ({"blocks": "100"}, "body.spectra[1].blocks: expected a valid integer, found '100'"),
        ({"time_utc": "2014"}, "body.spectra[1].time_utc: expected an ISO 8601 date"),
        ({"power": [1.0]}, "body.spectra[1].power: expected 4 channels, found 1"),
        ({"blocks": MISSING}, "body.spectra[1].blocks: expected a value, found nothing"),
    ],
)
def test_a_refusal_names_the_place_what_was_expected_and_what_was_found(
    client: TestClient, change: dict[str, Any], sentence: str
) -> None:
    row = {name: value for name, value in spectrum(1, **change).items() if value is not MISSING}
    answer = client.post("/v1/spectra", json=batch(spectrum(), row))
    assert (answer.status_code, answer.json()["type"], count(client)) == (422, "urn:lbacal:bad_input", 0)
    assert answer.json()["detail"].startswith(sentence)


def test_spectra_on_other_channels_are_refused_with_what_to_do(client: TestClient) -> None:
    answer = client.post("/v1/spectra", json={**batch(spectrum()), "frequency_mhz": [30.0, 45.0]})
    assert answer.status_code == 422
    assert "lbacal spectra and lbacal import average to them with --instrument" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("station", ["CS009"] * 8, "body: station, row 0: expected one of CS001, CS002, found 'CS009'"),
        ("antenna", [0, 0, 1, 1, 0, 0, 1, 77], "body: antenna, row 7: expected an antenna of CS001 (0 to 2), found 77"),
        ("event_id", ["a/b"] * 4 + ["c"] * 4, "body: event_id, row 0: expected at most 200 printable characters"),
        ("event_id", ["a"] * 4 + ["  "] * 4, "body: event_id, row 4: expected at most 200 printable characters"),
        ("time_unix", [1.4e9] * 7 + [1.41e9], "body: time_unix, row 7: expected a time within 60 s"),
        ("time_unix", [1.2e9] * 8, "body: time_unix, row 0: expected an instant of 2009 or later"),
        ("frequency_mhz", [30.0, 45.0, 60.0, 81.0], "body: frequency_mhz, channel 3: expected 80 MHz"),
        ("power", -np.ones((8, 4)), "body: power, row 0: expected finite power > 0"),
        ("power", 1e308 * np.ones((8, 4)), "body: power, row 0: expected a power from 1e-100 to 1e+100, found 1e+308"),
    ],
)
def test_a_bad_spectra_file_is_refused_whole(
    client: TestClient, file: bytes, name: str, values: Any, sentence: str
) -> None:
    content = io.BytesIO(file)
    with h5py.File(content, "a") as opened:
        del opened[name]
        opened[name] = values
    answer = post_file(client, content.getvalue())
    assert answer.status_code == 422, answer.text
    assert answer.json()["detail"].startswith(sentence)
    assert count(client) == 0


@pytest.mark.parametrize("sha256", ["", "x", "0" * 63, ",".join(["0" * 64] * 101), "0" * 64 + ","])
def test_a_receipt_is_asked_for_by_hashes(client: TestClient, sha256: str) -> None:
    assert client.get("/v1/spectra/receipts", params={"sha256": sha256}).status_code == 422


@pytest.mark.parametrize(
    ("content", "media", "status"),
    [
        (b"{", "application/json", 400),
        (b"", "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b"", "application/x-hdf5", 400),
        (b"{}", "application/x-hdf5", 400),
        (write_example("e")[:2000], "application/x-hdf5", 400),
        (b"{}", "text/plain", 415),
        (b"{}", "", 415),
    ],
)
def test_a_body_that_is_not_what_it_says(client: TestClient, content: bytes, media: str, status: int) -> None:
    answer = client.post("/v1/spectra", content=content, headers={"Content-Type": media})
    assert answer.status_code == status, answer.text


def test_a_body_above_the_limit_is_refused_also_without_a_length(client: TestClient) -> None:
    for content in (b" " * 65 * 10**6, (b" " * 10**6 for _ in range(65))):
        assert post(client, content).status_code == 413


def test_a_body_that_changes_one_thing_is_small(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum()))
    answer = client.post("/v1/events/e0/flag", json={"flag": "x", "reason": "r" * 100_000})
    assert answer.status_code == 413
    assert "65536" in answer.json()["detail"]


def campaign_of(first: int, count: int, times: float = 1.0, **more: Any) -> dict[str, Any]:
    """One spectrum of a path a day from a day of 2014 on, the daily variation of the sky a factor of two."""
    rows = []
    for day in range(first, first + count):
        sky = times * 2.0 ** (0.5 * np.sin(day))
        time_utc = f"{np.datetime64('2014-01-01') + day}T12:00:00Z"
        power = [sky * one for one in (4.0, 3.0, 2.0, 1.0)]
        rows.append(spectrum(event_id=f"d{day}", time_utc=time_utc, power=power, **more))
    return batch(*rows)


def usable(factory: Factory) -> int:
    with factory.database.read() as stores:
        return stores.spectra.content(Window(0, 2 * 10**15))[0]


def test_what_does_not_belong_is_stored_said_and_in_no_fit(client: TestClient, factory: Factory) -> None:
    first = client.post("/v1/spectra", json=campaign_of(0, 40))
    assert first.json() == {"received": 40, "stored": 40, "duplicates": 0}, "nothing is stored to compare it with"
    body = json.dumps(campaign_of(40, 6, 10.0)).encode()
    answer = post(client, body)
    assert (answer.status_code, answer.json()["stored"]) == (201, 6)
    (sentence,) = answer.json()["warnings"]
    assert re.match(
        r"CS001 antenna 0 X: [\d.]+ times the power stored nearest in time \(\+[\d.]+ dB\); 6 spectra", sentence
    )
    factor, decibels = (float(one) for one in re.findall(r"([\d.]+) (?:times|dB)", sentence))
    assert 10.0 / 2.0**0.5 < factor < 10.0 * 2.0**0.5
    assert decibels == pytest.approx(10.0 * np.log10(factor), abs=0.1)
    assert usable(factory) == 40
    again = post(client, body)
    assert (again.status_code, again.json()) == (200, {**answer.json(), "stored": 0, "duplicates": 6})
    assert client.get("/v1/spectra/receipts", params={"sha256": hashlib.sha256(body).hexdigest()}).json()["warnings"]
    listed = client.get("/v1/events", params={"flag": "far_level"}).json()["events"]
    assert [(event["event_id"], event["waiting"]) for event in listed] == [(f"d{day}", 1) for day in range(40, 46)]
    more = client.post("/v1/spectra", json=campaign_of(46, 3, 10.0)).json()
    assert more["warnings"], "those that wait are not taken for what is usual"
    assert usable(factory) == 40
    assert "warnings" not in client.post("/v1/spectra", json=campaign_of(49, 20)).json()
    look_for_due_work(factory)
    assert usable(factory) == 60, "nine among ordinary ones are exceptions, and wait"
    flag = client.post("/v1/events/d40/flag", json={"flag": None, "reason": "the attenuator is on record"})
    assert (flag.json()["waiting"], usable(factory)) == (0, 61)


def test_what_was_held_against_another_state_waited_for_ever(client: TestClient, factory: Factory) -> None:
    """Labels were exchanged: the first event behind that was at the peak of the day, and those since have its level."""
    client.post("/v1/spectra", json=campaign_of(0, 40))
    assert client.post("/v1/spectra", json=campaign_of(58, 1, 2.2)).json()["warnings"]
    look_for_due_work(factory)
    assert usable(factory) == 40, "nothing has come beside it"
    client.post("/v1/spectra", json=campaign_of(59, 60, 2.2))
    client.post("/v1/spectra", json=campaign_of(119, 1, 30.0))
    look_for_due_work(factory)
    assert usable(factory) == 101
    assert [one["event_id"] for one in client.get("/v1/events?flag=far_level").json()["events"]] == ["d119"]


@pytest.mark.parametrize("times", [0.8, 1.01, 1.2, 1.4])
def test_no_step_that_electronics_make_is_warned_of(client: TestClient, factory: Factory, times: float) -> None:
    client.post("/v1/spectra", json=campaign_of(0, 8))
    assert "warnings" not in client.post("/v1/spectra", json=campaign_of(8, 60, times)).json()
    assert usable(factory) == 68


@pytest.mark.parametrize("times", [0.05, 10.0, 1000.0])
def test_a_level_that_stays_is_in_fits_after_the_night(client: TestClient, factory: Factory, times: float) -> None:
    """Also where it came in several bodies, and beside a path that did not change."""
    for first, count in ((0, 30), (30, 8), (38, 40)):
        own = 1.0 if first == 0 else times
        assert ("warnings" in client.post("/v1/spectra", json=campaign_of(first, count, own)).json()) == (first > 0)
        assert "warnings" not in client.post("/v1/spectra", json=campaign_of(first, count, dipole="Y")).json()
    assert usable(factory) == 30 + 78
    look_for_due_work(factory)
    assert usable(factory) == 2 * 78
    assert "warnings" not in client.post("/v1/spectra", json=campaign_of(78, 5, times)).json()
    assert client.get("/v1/events", params={"flag": "far_level"}).json()["events"] == []
