"""`lbacal serve`: the API and the page; on SQLite a whole service in one command."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from typing import Annotated

import typer

RESTART_S = 1.0


def serve(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on.", min=1, max=65535)] = 8000,
    all_in_one: Annotated[
        bool | None,
        typer.Option(
            "--all-in-one/--api-only", help="With or without scheduler and worker; by default with on SQLite."
        ),
    ] = None,
) -> None:
    """Serve the API and the page.

    Example: lbacal serve --host 127.0.0.1 --port 8000

    On SQLite the schema is upgraded first, and scheduler and worker run as one child process that ends with this one.
    On PostgreSQL an old schema is refused: run `lbacal db upgrade`, `lbacal scheduler` and `lbacal worker` beside it.
    """
    import uvicorn

    from service.app import make_app
    from service.cli.connections import configure_server, listen
    from service.cli.opening import open_factory
    from service.storage.migration import require_current, upgrade
    from service.storage.processes import API
    from service.usecases.status import Pulse

    factory = open_factory()
    settings = factory.settings
    if settings.is_sqlite:
        upgrade(factory.database)
    require_current(factory.database)
    listening = listen(host, port)
    has_child = settings.is_sqlite if all_in_one is None else all_in_one
    child = _Child() if has_child else None
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: sys.exit(0))  # uvicorn ends what it began, then raises the signal again
    print(f"lbacal serves {factory.instrument.name} on http://{host}:{port} (documentation: /docs)", flush=True)
    try:
        with Pulse(factory.database, API):
            uvicorn.Server(configure_server(make_app(factory), settings.max_connections)).run([listening])
    finally:
        if child:
            child.stop()


class _Child:
    """Scheduler and worker in a process of their own: started anew should it die, ended by closing its input."""

    def __init__(self) -> None:
        self._is_stopping = threading.Event()
        self._process = self._start()
        self._watch = threading.Thread(target=self._keep_alive, daemon=True)
        self._watch.start()

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-m", "service.cli.background"], stdin=subprocess.PIPE)

    def _keep_alive(self) -> None:
        while True:
            self._process.wait()
            if self._is_stopping.wait(RESTART_S):
                return
            self._process = self._start()

    def stop(self) -> None:
        """End the child and wait for it."""
        self._is_stopping.set()
        if self._process.stdin:
            self._process.stdin.close()
        self._process.wait()
        self._watch.join()
