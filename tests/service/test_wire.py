"""What comes over the wire is what a synced cache holds: the client at a server that is there, and that is gone."""

from __future__ import annotations

import json
import socket
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table
from fastapi.testclient import TestClient
from typer.testing import CliRunner

import lbacal
from lbacal.cache import Cache, CacheError
from lbacal.cli.main import add_commands, app
from lbacal_core.errors import BadInputError, LbacalError
from service.cli import database
from service.factory import Factory
from service.storage.versions import Version
from tests.service.conftest import listening, promote

ABSENT = "http://127.0.0.1:9"
KINDS = ("json", "csv", "ecsv", "fits", "hdf5")
PATH = {"station": "CS001", "antenna": 0, "dipole": "X"}
INSTANTS = (
    "2012-12-31T23:59:59.999999Z", "2013-01-01", "2013-12-31T23:59:59.999999Z", "2014-01-01T00:00:00Z", "2014-03-01",
    "2014-05-31T23:59:59.999999Z", "2014-06-01T00:00:00+00:00", "2014-12-31", "2015-01-01", "2099-01-01",
)  # fmt: skip


@pytest.fixture
def tagged(client: TestClient, stored: dict[str, Version], clock: Any) -> str:
    """A ledger with all scopes, gaps and a withdrawal, frozen as `paper`; what came later is not in the tag."""
    promote(client, stored["array"], "2013-01-01", "2015-01-01")
    promote(client, stored["station"], "2014-01-01", "2014-06-01")
    promote(client, stored["path"], "2014-03-01")
    promote(client, None, "2014-06-01", "2014-07-01", **PATH)
    made = client.put("/v1/tags/paper", json={"reason": "test"})
    assert made.status_code == 201, made.text
    clock.now += 100_000_000
    promote(client, stored["other"], "2012-01-01")
    promote(client, stored["station"], "2001-01-01")
    return "paper"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LBACAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def ask_all(ask: Callable[..., bytes], **more: Any) -> list[Any]:
    """Every question to every instant: the answer, or the sentence of the refusal."""
    said: list[Any] = []
    questions = [PATH, {"station": "CS001"}, {"station": "CS002", "dipole": "Y"}, {}, {"scope": "array"}]
    for at in INSTANTS:
        for question in questions:
            for kind in KINDS if at == "2014-03-01" else ("json",):
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore", lbacal.CachedAnswerWarning)
                        said.append(ask(**question, at=at, format=kind, **more))
                except lbacal.RefusedError as error:
                    said.append((error.status, error.code))
    return said


def test_the_cache_gives_the_bytes_that_the_server_gave(factory: Factory, tagged: str, cache: Path) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        snapshot, fetched = client.sync(tagged)
        assert fetched == sum(len(station["edges"]) for station in snapshot.stations.values())
        served = ask_all(client.effective, as_of=snapshot.as_of)
    assert len({str(one) for one in served}) > 20, "the questions have many answers"
    with lbacal.Client(ABSENT) as client:
        assert ask_all(client.effective, as_of=snapshot.as_of) == served
        assert ask_all(client.effective, tag=tagged) == served
        assert ask_all(client.effective) == served
    assert cache.is_dir()


@pytest.mark.usefixtures("cache")
def test_sync_keys_and_effective_answer_as_json(factory: Factory, tagged: str, monkeypatch: pytest.MonkeyPatch) -> None:
    add_commands()
    monkeypatch.setattr(database, "_factory", lambda: factory)

    def run(*arguments: str) -> Any:
        told = CliRunner().invoke(app, [*arguments, "--json"]).stdout.splitlines()
        return json.loads("".join(line for line in told if "[info " not in line))  # what the server logs

    with listening(factory) as url:
        monkeypatch.setenv("LBACAL_URL", url)
        made = run("sync", tagged)
        assert (made["tag"], made["stations"], made["fetched"] > 5) == (tagged, ["", "CS001", "CS002"], True)
        asked = ["effective", "--station", "CS001", "--antenna", "0", "--dipole", "X", "--at", "2014-03-01"]
        assert run(*asked)["curves"][0]["answered_by"] == "antenna"
    key = run("keys", "create", "--scope", "read", "--expires", "1")
    (listed,) = [one for one in run("keys", "list") if one["number"] == key["number"]]
    assert (listed["scopes"], listed["revoked"], key["text"] in str(listed)) == (["read"], None, False)
    assert listed["created"] < listed["expires"]


@pytest.mark.usefixtures("tagged")
def test_python_is_answered_in_the_format_that_it_names(factory: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    with listening(factory) as url:
        monkeypatch.setenv("LBACAL_URL", url)
        table = lbacal.effective(**PATH, at="2014-03-01")
        body = lbacal.effective(**PATH, at="2014-03-01", format="ecsv")
        with pytest.raises(lbacal.RefusedError, match="nuradio"):
            lbacal.effective(**PATH, at="2014-03-01", format="xml")
    np.testing.assert_array_equal(Table.read(body.decode(), format="ascii.ecsv")["c"], table["c"].value)


@pytest.mark.usefixtures("cache")
def test_who_is_answered_from_the_cache_is_told_at_once(factory: Factory, tagged: str) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        snapshot, _ = client.sync(tagged)
        table = client.effective(**PATH, at="2014-03-01")
        assert table.meta["source"] == url
    began = time.monotonic()
    with lbacal.Client(ABSENT) as client, pytest.warns(lbacal.CachedAnswerWarning, match="does not answer: tag paper"):
        table = client.effective(**PATH, at="2014-03-01")
    assert time.monotonic() - began < 2.0
    assert table.meta["source"].startswith(f"cache: tag paper, as known at {snapshot.as_of}, synced at 20")


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("asked", [PATH | {"antenna": 77}, PATH | {"station": "CS999"}])
def test_what_a_server_refuses_a_cache_refused_with_an_error_of_another_kind(
    factory: Factory, tagged: str, asked: dict[str, Any]
) -> None:
    refused = list[tuple[int, str]]()
    with listening(factory) as url, lbacal.Client(url) as client, lbacal.Client(ABSENT) as alone:
        client.sync(tagged)
        for one in (client, alone):
            with pytest.raises(lbacal.RefusedError) as told:
                one.effective(**asked, at="2014-03-01")
            refused.append((told.value.status, told.value.code))
    assert refused[0] == refused[1]


@pytest.mark.usefixtures("cache")
def test_a_server_that_took_the_question_and_said_nothing_held_the_cache_back_for_a_minute(
    factory: Factory, tagged: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lbacal.client.STUCK_S", 0.2)
    with listening(factory) as url, lbacal.Client(url) as client:
        client.sync(tagged)
    began = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with lbacal.Client(address) as client, pytest.warns(lbacal.CachedAnswerWarning, match="does not answer: tag"):
            table = client.effective(**PATH, at="2014-03-01")
    assert time.monotonic() - began < 30
    assert table.meta["source"].startswith("cache: tag paper")


@pytest.mark.usefixtures("cache", "stored")
def test_a_second_sync_fetches_only_what_is_damaged(factory: Factory, tagged: str, cache: Path) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        snapshot, _ = client.sync(tagged)
        assert client.sync(tagged)[1] == 0
        digest = min(snapshot.files)
        path = cache / "files" / digest[:2] / digest
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        with pytest.raises(CacheError, match=r"is damaged or missing: run `lbacal sync paper`"):
            ask_all(lbacal.Client(ABSENT).effective)
        (uses,) = {sum(d == digest for _, d in s["edges"]) for s in snapshot.stations.values()} - {0}
        assert client.sync(tagged)[1] == uses
        assert len(ask_all(lbacal.Client(ABSENT).effective)) > 0


def test_every_flipped_byte_of_a_list_is_noticed(factory: Factory, tagged: str, cache: Path) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        client.sync(tagged)
    pointer = cache / "tags" / "paper.json"
    digest = json.loads(pointer.read_text())["list"]
    listed = cache / "files" / digest[:2] / digest
    for path in (pointer, listed):
        whole = path.read_bytes()
        for k in range(0, len(whole), max(1, len(whole) // 60)):
            path.write_bytes(whole[:k] + bytes([whole[k] ^ 2]) + whole[k + 1 :])
            with pytest.raises(CacheError):
                Cache(cache).snapshot("paper")
        path.write_bytes(b"")
        with pytest.raises(CacheError):
            Cache(cache).snapshot("paper")
        path.write_bytes(whole)
    assert Cache(cache).snapshot(None).tag == "paper"


def test_without_a_cache_it_fails_within_two_seconds_and_names_the_next_step(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It was silent for 16 s, and then asked whether the address was right."""
    monkeypatch.delenv("LBACAL_CACHE", raising=False)
    began = time.monotonic()
    with pytest.raises(
        lbacal.UnreachableError, match=r"nobody answers at .*: start `lbacal serve` there, or set LBACAL_URL"
    ):
        lbacal.Client(ABSENT).effective(**PATH, at="2014-03-01")
    with socket.create_server(("127.0.0.1", 0), backlog=0) as deaf:
        blocked = [socket.create_connection(deaf.getsockname()) for _ in range(1)]
        url = f"http://127.0.0.1:{deaf.getsockname()[1]}"
        with pytest.raises(lbacal.UnreachableError):
            lbacal.Client(url).effective(**PATH, at="2014-03-01")
        for one in blocked:
            one.close()
    assert time.monotonic() - began < 5.0
    monkeypatch.setenv("LBACAL_CACHE", str(tmp_path))
    with pytest.raises(CacheError, match="holds no tag: run `lbacal sync TAG`"):
        lbacal.Client(ABSENT).effective(**PATH, at="2014-03-01")


@pytest.mark.usefixtures("cache")
def test_what_a_cache_does_not_know_is_refused_in_a_sentence(factory: Factory, tagged: str) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        with pytest.raises(BadInputError, match=rf"a tag of the server.*found '{tagged}s' \(is {tagged} meant\?\)"):
            client.sync(f"{tagged}s")
        client.sync(tagged)
    client = lbacal.Client(ABSENT)
    for question, sentence in (
        ({"station": "CS009"}, "station: expected one of CS001, CS002"),
        ({"station": "cs001"}, r"found 'cs001' \(is CS001 meant\?\)"),
        ({"station": "CS001", "antenna": 77}, "antenna: expected an antenna of CS001"),
        ({"antenna": 1}, "antenna: expected a station beside it"),
        ({"dipole": "Z"}, "dipole: expected one of X, Y"),
        ({"as_of": "2013-01-01"}, "the instant of the cached tag paper"),
        ({"at": "2014"}, "at: expected an ISO 8601 date"),
        ({"gap": "hold"}, "nobody answers at"),
        ({"tag": "../x"}, "tag: expected letters"),
        ({"tag": "other"}, "run `lbacal sync other`"),
        ({"tag": tagged.upper()}, rf"does not hold the tag '{tagged.upper()}' \(is {tagged} meant\?\)"),
    ):
        with pytest.raises(LbacalError, match=sentence):
            client.effective(**{"at": "2014-03-01", **question})


@pytest.mark.usefixtures("cache")
def test_a_part_of_a_tag_answers_what_it_holds_and_says_what_it_does_not(factory: Factory, tagged: str) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        _, whole = client.sync(tagged)
        served = {
            at: client.effective("CS002", at=at, tag=tagged, format="json") for at in ("2014-03-01", "2014-06-15")
        }
        snapshot, fetched = client.sync(tagged, stations=["CS002"], since="2014-03-01", until="2014-07-01")
        assert (fetched, list(snapshot.stations)) == (0, ["CS002"])
        assert len(snapshot.files) < whole
        # what is not held is asked of the server, by the tag as before
        assert client.effective("CS001", at="2014-03-01", tag=tagged).meta["source"] == url
        with pytest.raises(BadInputError, match="station: expected one of CS001, CS002, found 'CS009'"):
            client.sync(tagged, stations=["CS009"])
        with pytest.raises(BadInputError, match="until: expected an ISO 8601 date"):
            client.sync(tagged, until="soon")
        with pytest.raises(BadInputError, match="an end after the beginning"):
            client.sync(tagged, since="2014-07-01", until="2014-03-01")
    client = lbacal.Client(ABSENT)
    for at, answer in served.items():
        assert client.effective("CS002", at=at, tag=tagged, format="json") == answer
    part = r"of paper CS002 from 2014-03-01T00:00:00Z until 2014-07-01T00:00:00Z alone"
    inside, before, end = "2014-03-01", "2014-02-28", "2014-07-01"
    for question in (
        {"station": "CS001", "at": inside},
        {"at": inside},
        {"scope": "array", "at": inside},
        {"station": "CS002", "at": before},
        {"station": "CS002", "at": end},
    ):
        with pytest.raises(CacheError, match=f"{part}.*run `lbacal sync paper`"):
            client.effective(**question)


def test_a_cache_from_before_parts_is_read(factory: Factory, tagged: str, cache: Path) -> None:
    with listening(factory) as url, lbacal.Client(url) as client:
        client.sync(tagged)
    pointer = cache / "tags" / "paper.json"
    kept = Cache(cache)
    content = json.loads((cache / "files" / (d := json.loads(pointer.read_text())["list"])[:2] / d).read_text())
    old = {name: value for name, value in content.items() if name not in ("only", "since", "until")}
    pointer.write_text(json.dumps({"list": kept._keep(json.dumps(old).encode())}))
    assert kept.snapshot("paper").part == ""
    assert kept.snapshot("paper").stations == content["stations"]
