from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from lbacal import transport
from lbacal.transport import Transport


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
