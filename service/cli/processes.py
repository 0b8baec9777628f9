"""`lbacal serve`, `scheduler` and `worker`, and how every process of the service begins.

On SQLite `serve` is a whole service in one command; elsewhere the others run as processes of their own.
"""

from __future__ import annotations

import logging
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lbacal.engine import HERE, Engine, read_address
from lbacal_core.errors import LbacalError

if TYPE_CHECKING:
    from service.factory import Factory
    from service.storage.database import Database

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


Check = Annotated[bool, typer.Option("--check", help="Only ask whether one lives on this machine: exit 0 or 1.")]


def scheduler(
    once: Annotated[bool, typer.Option("--once", help="Look for due work now, and end.")] = False, check: Check = False
) -> None:
    """Find due refits: now, which makes up for missed days, and then once a day. It enqueues, workers do.

    Example: lbacal scheduler
    """
    if check:
        _check("scheduler")
        return
    from service.scheduler import look_for_due_work, run_scheduler

    factory = _open()
    if once:
        print(f"{len(look_for_due_work(factory))} jobs enqueued")
        return
    run_scheduler(factory, _stop_on_signal())


def worker(
    until_idle: Annotated[bool, typer.Option("--until-idle", help="End when nothing is left to do.")] = False,
    check: Check = False,
) -> None:
    """Do refits. Any number of workers may run, on any machine that reaches the database.

    Example: lbacal worker

    With LBACAL_DASK it computes on dask, a part a thread.
    """
    if check:
        _check("worker")
        return
    from service.worker import Worker

    with Engine(read_address()) as engine:
        Worker(_open(engine)).run(_stop_on_signal(), until_idle=until_idle)


def _open(engine: Engine = HERE) -> Factory:
    from service.storage.migration import require_current

    factory = open_factory(engine)
    require_current(factory.database)
    return factory


def _check(kind: str) -> None:
    """End with an error unless a process of a kind lives on this machine."""
    from service.config import read_settings
    from service.factory import Factory

    with Factory(read_settings()).database.read() as stores:
        found = [one for one in stores.processes.all() if one.kind == kind]
    here = f"{socket.gethostname()}:"
    if not any(one.is_alive for one in found if one.name.startswith(here)):
        raise LbacalError(f"no {kind} on {here[:-1]} has been seen for a minute")
    print(f"a {kind} lives on {here[:-1]}")


def _stop_on_signal() -> threading.Event:
    stop = threading.Event()
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: stop.set())
    return stop


# How every process of the service begins: settings, log, instrument and sky, and a database that answers.

PAUSE_S = 1.0


def open_factory(engine: Engine = HERE) -> Factory:
    """The use cases on the database of the settings; what is wrong with the settings shows here, not in a later run."""
    from service.config import read_settings
    from service.factory import Factory

    settings = read_settings()
    configure_logs(settings.log_level)
    factory = Factory(settings, engine=engine)
    # an instrument or sky file that is missing or wrong is noticed before anything is promised
    _ = factory.instrument if settings.sky_power is None else factory.simulation.sky_power
    wait_for_database(factory.database, settings.wait_s)
    return factory


def wait_for_database(database: Database, wait_s: float) -> None:
    """Wait for a database that is still starting; one that will never answer is refused at once."""
    from service.errors import UnavailableError

    end, is_told = time.monotonic() + wait_s, False
    while True:
        try:
            database.ping()
        except UnavailableError as error:
            if not error.is_passing or time.monotonic() > end:
                raise
            if not is_told:
                print(f"lbacal: {error}; waiting for it up to {wait_s:g} s", file=sys.stderr, flush=True)
                is_told = True
            time.sleep(PAUSE_S)
        else:
            return


TALKATIVE = ("alembic", "apscheduler")
"""Libraries that tell each of their steps."""


def configure_logs(level: str) -> None:
    """Write events of a level, such as `info`, and above as JSON lines, those of libraries included."""
    import structlog

    first: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Any] = [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    number = logging.getLevelNamesMapping()[level.upper()]
    structlog.configure(
        processors=[*first, *last],
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
    foreign = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*first, structlog.stdlib.add_logger_name],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(foreign)
    logging.basicConfig(level=number, handlers=[handler], force=True)
    logging.captureWarnings(True)
    for name in TALKATIVE:
        logging.getLogger(name).setLevel(max(number, logging.WARNING))
