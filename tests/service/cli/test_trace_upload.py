"""Against a small server of our own: what is sent, and what its answers lead to."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from lbacal_core.errors import LbacalError
from lbacal_core.spectra import Spectra
from service.cli.trace_upload import send_spectra


@dataclass
class Server:
    """Stores bodies; `answers` are given first, one a request."""

    url: str = ""
    answers: list[int] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            status = state.answers.pop(0) if state.answers else 201
            if status == 201:
                state.bodies.append(body)
                state.headers.append(dict(self.headers))
            content = {"received": 2, "stored": 2, "duplicates": 0} if status == 201 else {"detail": "unknown station"}
            self.send_response(status)
            if status == 503:
                self.send_header("Retry-After", "0")
            self.end_headers()
            self.wfile.write(json.dumps(content).encode())

        def log_message(self, *_: object) -> None:
            pass

    listener = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=listener.serve_forever)
    thread.start()
    state.url = f"http://127.0.0.1:{listener.server_port}"
    yield state
    listener.shutdown()
    thread.join()
    listener.server_close()


@pytest.fixture
def spectra() -> Spectra:
    return Spectra(
        frequency_mhz=np.arange(30.0, 81.0),
        power=np.random.default_rng(1).gamma(400, 1 / 400, (4, 51)),
        event_id=np.array(["a", "a", "b", "b"]),
        time_unix=np.array([1.4e9, 1.4e9, 1.5e9, 1.5e9]),
        station=np.full(4, "CS002"),
        antenna=np.array([1, 1, 1, 1]),
        dipole=np.array(["X", "Y", "X", "Y"]),
        blocks=np.full(4, 400),
        environment={"temperature_c": np.array([np.nan, np.nan, 4.5, np.nan])},
    )


def test_every_event_is_one_request_with_the_key_and_exact_numbers(server: Server, spectra: Spectra) -> None:
    assert send_spectra(spectra, server.url, "secret") == {"received": 4, "stored": 4, "duplicates": 0}
    assert server.headers[0]["Authorization"] == "Bearer secret"
    sent = json.loads(server.bodies[1])
    assert sent["frequency_mhz"] == spectra.frequency_mhz.tolist()
    assert [row["event_id"] for row in sent["spectra"]] == ["b", "b"]
    assert sent["spectra"][0]["time_utc"] == "2017-07-14T02:40:00.000000+00:00"
    assert sent["spectra"][0]["env"] == {"temperature_c": 4.5}
    assert "env" not in sent["spectra"][1]
    assert np.array_equal([row["power"] for row in sent["spectra"]], spectra.power[2:])


def test_a_busy_server_is_asked_again(server: Server, spectra: Spectra) -> None:
    server.answers = [503, 503]
    assert send_spectra(spectra, server.url, None)["stored"] == 4


def test_refusals_and_absent_servers_are_one_sentence(server: Server, spectra: Spectra) -> None:
    server.answers = [422]
    with pytest.raises(LbacalError, match="event a was refused: 422 unknown station"):
        send_spectra(spectra, server.url, None)
    with pytest.raises(LbacalError, match="cannot be reached"):
        send_spectra(spectra, "http://127.0.0.1:9", None)
