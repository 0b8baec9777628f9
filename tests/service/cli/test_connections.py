from __future__ import annotations

import logging
import resource
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
import uvicorn
from fastapi import FastAPI

from lbacal_core.errors import LbacalError
from service.cli import connections
from service.cli.connections import SPARE_FILES, configure_server, listen


@contextmanager
def serving(most: int) -> Iterator[tuple[str, int]]:
    """A server that answers `alive`."""
    app = FastAPI(openapi_url=None)
    app.get("/")(lambda: "alive")
    listening = listen("127.0.0.1", 0)
    server = uvicorn.Server(configure_server(app, most))
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    try:
        yield listening.getsockname()
    finally:
        server.should_exit = True
        thread.join()


def ask(address: tuple[str, int]) -> bytes:
    with socket.create_connection(address) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        return b"".join(iter(lambda: connection.recv(4096), b""))


def is_ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def test_half_a_request_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.1)
    with serving(10) as address:
        for half in (b"", b"GET / HTTP/1.1\r\nHost:", b"GET / HTTP/1.1\r\nHost: x\r\n\r\nGET / HT"):
            with socket.create_connection(address) as connection:
                connection.sendall(half)
                while not is_ended(connection):  # what comes before the end is the first answer
                    pass
        assert b"alive" in ask(address)


def test_connections_above_the_limit_are_closed_and_the_others_served() -> None:
    with serving(3) as address:
        held = [socket.create_connection(address, source_address=(f"127.0.0.{k}", 0)) for k in (2, 3, 4)]
        with socket.create_connection(address) as fourth:
            assert is_ended(fourth)
        for connection in held:
            connection.close()
        # the server notices that they left on its next turns
        while b"alive" not in _ask_or_nothing(address):
            pass


@pytest.mark.parametrize(("proxies", "kept"), [("", 4), ("127.0.0.1", 4), ("127.0.0.1, 127.0.0.2", 7)])
def test_one_address_cannot_have_all_connections(monkeypatch: pytest.MonkeyPatch, proxies: str, kept: int) -> None:
    """500 unfinished heads from one address, and nobody else was answered."""
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", proxies)
    with serving(7) as address, ExitStack() as held:
        answered = 0
        for _ in range(7):
            one = held.enter_context(socket.create_connection(address, source_address=("127.0.0.2", 0)))
            with suppress(ConnectionError):
                one.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
                answered += b"200 OK" in one.recv(4096)
        assert answered == kept
        assert (b"alive" in _ask_or_nothing(address)) == (kept < 7)


BURST = """
import resource, socket, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
held = [socket.create_connection(("127.0.0.1", int(sys.argv[1]))) for _ in range(900)]
print(len(held), flush=True)
time.sleep(60)
"""


def test_a_burst_of_connections_leaves_files_to_accept_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """1,100 at 1,024 files: `accept` failed in a loop, with 309 MB of log in 35 s."""
    monkeypatch.setattr(connections, "HEAD_S", 0.2)
    files = resource.getrlimit(resource.RLIMIT_NOFILE)
    in_use = len(list(Path("/proc/self/fd").iterdir()))
    failures: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: failures.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("asyncio").addHandler(handler)
    command = [sys.executable, "-c", BURST]
    try:
        with serving(20) as address:
            resource.setrlimit(resource.RLIMIT_NOFILE, (in_use + 20 + SPARE_FILES, files[1]))
            with subprocess.Popen([*command, str(address[1])], stdout=subprocess.PIPE, text=True) as attacker:
                assert attacker.stdout is not None
                assert attacker.stdout.readline() == "900\n"
                while b"alive" not in _ask_or_nothing(address):
                    pass
                attacker.kill()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, files)
        logging.getLogger("asyncio").removeHandler(handler)
    assert failures == []


def _ask_or_nothing(address: tuple[str, int]) -> bytes:
    try:
        return ask(address)
    except ConnectionError:
        return b""


def test_a_port_in_use_is_a_sentence() -> None:
    with listen("127.0.0.1", 0) as taken, pytest.raises(LbacalError) as refused:
        listen("127.0.0.1", port := taken.getsockname()[1])
    assert str(refused.value) == f"127.0.0.1, port {port}: Address already in use; choose another with --port"


def test_an_answer_does_not_wait_40_ms_for_the_client_to_acknowledge_its_head() -> None:
    """Without TCP_NODELAY every answer on a kept connection took 44 ms."""
    with listen("127.0.0.1", 0) as listening, socket.create_connection(listening.getsockname()):
        accepted, _ = listening.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
