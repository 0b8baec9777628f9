"""Spectra that are refused: whole, with the place, what was expected and what was found."""

from __future__ import annotations

import io
import json
from typing import Any

import h5py
import numpy as np
import pytest
from fastapi.testclient import TestClient

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


def post(client: TestClient, content: str | bytes) -> Any:
    return client.post("/v1/spectra", content=content, headers={"Content-Type": "application/json"})


def post_file(client: TestClient, content: bytes) -> Any:
    return client.post("/v1/spectra", content=content, headers={"Content-Type": "application/x-hdf5"})


BAD = {
    "another grid": batch(spectrum(), mhz=[30.0, 45.0, 60.0, 81.0]),
    "fewer channels": batch(spectrum(power=[1.0, 2.0]), mhz=[30.0, 45.0]),
    "a short row": batch(spectrum(power=[1.0, 2.0])),
    "unknown station": batch(spectrum(station="CS003")),
    "unknown antenna": batch(spectrum(antenna=3)),
    "negative antenna": batch(spectrum(antenna=-1)),
    "huge antenna": batch(spectrum(antenna=2**70)),
    "unknown dipole": batch(spectrum(dipole="Z")),
    "zero power": batch(spectrum(power=[1.0, 0.0, 3.0, 4.0])),
    "negative power": batch(spectrum(power=[1.0, -2.0, 3.0, 4.0])),
    "null power": batch(spectrum(power=[1.0, None, 3.0, 4.0])),
    "power as text": batch(spectrum(power=[1.0, "2.0", 3.0, 4.0])),
    "power as bool": batch(spectrum(power=[1.0, True, 3.0, 4.0])),
    "no blocks": batch(spectrum(blocks=0)),
    "half a block": batch(spectrum(blocks=1.5)),
    "before 2009": batch(spectrum(time_utc="2008-12-31T23:59:59Z")),
    "the future": batch(spectrum(time_utc="2020-01-02T01:00:00Z")),
    "a year": batch(spectrum(time_utc="2014")),
    "a number": batch(spectrum(time_utc=1.4e9)),
    "no event": batch(spectrum(event_id="")),
    "control character": batch(spectrum(event_id="a\x00b")),
    "unknown field": batch(spectrum(antena=1)),
    "missing field": batch({key: value for key, value in spectrum().items() if key != "blocks"}),
    "no spectra": batch(),
    "a list": [spectrum()],
    "a covariate as text": batch(spectrum(env={"temperature_c": "cold"})),
    "another resistance": {**batch(spectrum()), "resistance_ohm": 75.0},
    "an event of two years": batch(spectrum(), spectrum(antenna=1, time_utc="2016-03-01T12:00:00Z")),
    "a slash in an event": batch(spectrum(event_id="2014/17")),
    "an event called .": batch(spectrum(event_id=".")),
    "an event called ..": batch(spectrum(event_id="..")),
    "a covariate with a space": batch(spectrum(env={"wind speed": 1.0})),
    "17 covariates": batch(spectrum(env={f"name_{k}": 1.0 for k in range(17)})),
    "17 covariates of one event": batch(
        spectrum(env={f"name_{k}": 1.0 for k in range(9)}),
        spectrum(antenna=1, env={f"name_{k}": 1.0 for k in range(8, 17)}),
    ),
    "more than 64 covariates in a batch": batch(*[spectrum(k, env={f"name_{k}": 1.0}) for k in range(66)]),
}


@pytest.mark.long
@pytest.mark.parametrize("body", BAD.values(), ids=BAD.keys())
def test_a_bad_batch_is_refused_whole(client: TestClient, body: Any) -> None:
    if isinstance(body, dict) and body["spectra"]:
        body = {**body, "spectra": [spectrum(7), *body["spectra"]]}
    answer = client.post("/v1/spectra", json=body)
    assert answer.status_code == 422, answer.text
    assert answer.json()["code" if "code" in answer.json() else "type"] == "urn:lbacal:bad_input"
    assert count(client) == 0


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_power_that_is_no_number_is_refused(client: TestClient, literal: str) -> None:
    text = json.dumps(batch(spectrum())).replace("2.0", literal)
    answer = client.post("/v1/spectra", content=text, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert count(client) == 0


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
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
        ({"antenna": 77}, "body.spectra[1].antenna: expected an antenna of CS001, found 77"),
        ({"antena": 1}, "body.spectra[1].antena: expected no field of this name, found 1"),
        ({"blocks": "100"}, "body.spectra[1].blocks: expected a valid integer, found '100'"),
        ({"time_utc": "2014"}, "body.spectra[1].time_utc: expected an ISO 8601 date"),
        ({"power": [1.0]}, "body.spectra[1].power: expected 4 channels, found 1"),
    ],
)
def test_a_refusal_names_the_place_what_was_expected_and_what_was_found(
    client: TestClient, change: dict[str, Any], sentence: str
) -> None:
    answer = client.post("/v1/spectra", json=batch(spectrum(), spectrum(1, **change)))
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith(sentence)


def test_a_missing_field_is_named(client: TestClient) -> None:
    row = {key: value for key, value in spectrum().items() if key != "blocks"}
    answer = client.post("/v1/spectra", json=batch(row))
    assert answer.json()["detail"] == "body.spectra[0].blocks: expected a value, found nothing"


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("station", ["CS009"] * 8, "body: station, row 0: expected one of CS001, CS002, found 'CS009'"),
        ("antenna", [0, 0, 1, 1, 0, 0, 1, 77], "body: antenna, row 7: expected an antenna of CS001, found 77"),
        ("event_id", ["a/b"] * 4 + ["c"] * 4, "body: event_id, row 0: expected at most 200 printable characters"),
        ("time_unix", [1.4e9] * 7 + [1.41e9], "body: time_unix, row 7: expected a time within 60 s"),
        ("time_unix", [1.2e9] * 8, "body: time_unix, row 0: expected an instant of 2009 or later"),
        ("frequency_mhz", [30.0, 45.0, 60.0, 81.0], "body: frequency_mhz, channel 3: expected 80 MHz"),
        ("power", -np.ones((8, 4)), "body: power, row 0: expected finite power > 0"),
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


def test_a_file_that_is_none_is_malformed(client: TestClient, file: bytes) -> None:
    for content in (b"", b"{}", file[:2000]):
        assert post_file(client, content).status_code == 400


@pytest.mark.parametrize(
    ("content", "media", "status"),
    [
        (b"{", "application/json", 400),
        (b"", "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b"{}", "text/plain", 415),
        (b"{}", "", 415),
    ],
)
def test_a_body_that_is_not_json(client: TestClient, content: bytes, media: str, status: int) -> None:
    answer = client.post("/v1/spectra", content=content, headers={"Content-Type": media})
    assert answer.status_code == status, answer.text


def test_a_body_above_the_limit_is_refused_also_without_a_length(client: TestClient) -> None:
    size = 65 * 10**6
    assert (
        client.post("/v1/spectra", content=b" " * size, headers={"Content-Type": "application/json"}).status_code == 413
    )
    chunks = (b" " * 10**6 for _ in range(65))
    assert client.post("/v1/spectra", content=chunks, headers={"Content-Type": "application/json"}).status_code == 413


def test_a_body_that_changes_one_thing_is_small(client: TestClient) -> None:
    client.post("/v1/spectra", json=batch(spectrum()))
    answer = client.post("/v1/events/e0/flag", json={"flag": "x", "reason": "r" * 100_000})
    assert answer.status_code == 413
    assert "65536" in answer.json()["detail"]
