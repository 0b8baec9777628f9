from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal import cache, transport
from lbacal.cache import Cache, Question
from lbacal.instants import parse_instant
from lbacal.transport import Transport, files_of_events
from lbacal_core.spectra.spectra import Spectra, read_spectra
from validation.running.clients import bodies_of_events


class Losing(BaseHTTPRequestHandler):
    """Does what is asked and loses the first two answers on the way back."""

    names: list[str | None]

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self.names.append(self.headers["Idempotency-Key"])
        if len(self.names) < 3:
            self.close_connection = True
            return
        self.send_response(202)
        self.send_header("Content-Length", "10")
        self.end_headers()
        self.wfile.write(b'{"job": 7}')

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def losing() -> Iterator[ThreadingHTTPServer]:
    Losing.names = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), Losing)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def test_one_refit_behind_a_proxy_that_loses_answers_is_asked_for_under_one_name(
    losing: ThreadingHTTPServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "FIRST_PAUSE_S", 0.001)
    connection = Transport(f"http://127.0.0.1:{losing.server_port}")
    for _ in range(2):
        assert connection.request("POST", "/v1/refits", body={}).json() == {"job": 7}
    connection.close()
    first, second, third, fourth = Losing.names
    assert first == second == third is not None, "six jobs were made of one request"
    assert fourth != first, "another request is another deed"


SPECTRA = Spectra(
    frequency_mhz=np.array([30.0, 31.0]), power=np.arange(1.0, 13.0).reshape(6, 2),
    event_id=np.array(["b", "a", "b", "c", "a", "Ä"]),
    time_unix=np.array([1.4e9 + 2, 1.4e9, 1.4e9 + 1, 1.4e9 + 1.5, 1.4e9 + 3, 1.4e9 + 9]),
    station=np.array(["CS002"] * 6), antenna=np.arange(6), dipole=np.array(list("XYXYXY")), blocks=np.full(6, 100),
    environment={"rain_mm_h": np.array([1.0, np.nan, 2.0, 3.0, 4.0, 5.0])},
)  # fmt: skip


def test_each_event_is_one_file_in_order_of_time_and_nothing_is_lost(tmp_path: Path) -> None:
    found = []
    for k, (count, rows, content) in enumerate(files_of_events(SPECTRA)):
        (tmp_path / f"{k}.h5").write_bytes(content)
        found.append(read_spectra(tmp_path / f"{k}.h5"))
        assert (len(found[-1]), count) == (rows, 1)
    assert [set(one.event_id.tolist()) for one in found] == [{"a"}, {"b"}, {"c"}, {"Ä"}]
    assert sorted(np.concatenate([one.power[:, 0] for one in found])) == SPECTRA.power[:, 0].tolist()
    assert found[0].environment["rain_mm_h"].tolist()[1:] == [4.0]
    assert found[0].time_unix.tolist() == [1.4e9, 1.4e9 + 3]


def test_a_bundle_takes_whole_events_until_it_holds_enough() -> None:
    assert [(count, rows) for count, rows, _ in files_of_events(SPECTRA, 3)] == [(2, 4), (2, 2)]
    assert [(count, rows) for count, rows, _ in files_of_events(SPECTRA, 100)] == [(4, 6)]
    assert list(files_of_events(SPECTRA.select(np.zeros(6, dtype=bool)))) == []


def test_the_same_spectra_make_the_same_bytes_and_others_do_not() -> None:
    first, again = (list(files_of_events(SPECTRA)) for _ in range(2))
    changed = replace(SPECTRA, power=SPECTRA.power * (1 + 1e-15))
    assert first == again
    assert not {content for *_, content in first} & {content for *_, content in files_of_events(changed)}


def test_json_says_of_each_event_what_the_file_does() -> None:
    bodies = list(bodies_of_events(SPECTRA))
    assert [[row["event_id"] for row in body["spectra"]] for body in bodies] == [["a", "a"], ["b", "b"], ["c"], ["Ä"]]
    assert bodies[0]["spectra"][0] == {
        "event_id": "a", "time_utc": "2014-05-13T16:53:20Z", "station": "CS002", "antenna": 1, "dipole": "Y",
        "blocks": 100, "power": [3.0, 4.0],
    }  # fmt: skip


class Server:
    """One station with one edge, whose C is the year of the tag's instant."""

    url = "http://server"

    def __init__(self, **tags: int) -> None:
        self.tags = tags
        self.fetched = 0

    def list(self, *_: Any) -> Any:
        """The tags."""
        return [{"name": name, "as_of": f"{year}-01-01T00:00:00Z"} for name, year in self.tags.items()]

    def get(self, *_: Any, **__: Any) -> Any:
        """The edges."""
        edge = "2014-01-01T00:00:00Z"
        return {"stations": [{"station": "CS002", "antennas": [1], "dipoles": ["X"], "edges": [edge]}]}

    def fetch(self, _: str, **params: Any) -> bytes:
        """What is in effect."""
        self.fetched += 1
        curve = {"station": "CS002", "antenna": 1, "dipole": "X", "c": [float(params["as_of"][:4])]}
        return json.dumps({"curves": [curve], "missing": []}).encode()


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cache:
    """A cache in which every sync is a day after the one before."""
    days = itertools.count(parse_instant("", "2026-01-01"), 86_400_000_000)
    monkeypatch.setattr(cache, "read_clock", lambda: next(days))
    return Cache(tmp_path)


def tell(kept: Cache, tag: str | None = None) -> float:
    snapshot = kept.snapshot(tag)
    asked = Question(parse_instant("", "2014-06-01"), "CS002", 1, "X", None)
    return float(json.loads(kept.answer(snapshot, asked))["curves"][0]["c"][0])


def test_without_a_name_the_tag_synced_last_answers(kept: Cache) -> None:
    server = Server(old=2020, new=2025)
    for names, last in ((("old", "new"), 2025.0), (("old",), 2020.0), (("new",), 2025.0)):
        for name in names:
            kept.sync(server, name)
        assert tell(kept) == last
    assert (tell(kept, "old"), tell(kept, "new")) == (2020.0, 2025.0)
    assert server.fetched == 2, "what is here and whole is not fetched again"


def test_a_tag_of_another_instant_is_fetched_anew(kept: Cache) -> None:
    """Made again on another server, it kept the answers of before, all hashes right."""
    kept.sync(Server(paper=2020), "paper")
    assert tell(kept) == 2020.0
    kept.sync(Server(paper=2025), "paper")
    assert tell(kept) == 2025.0
