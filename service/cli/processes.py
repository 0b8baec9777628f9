"""`lbacal scheduler` and `lbacal worker`: what `lbacal serve` runs as a child, as processes of their own."""

from __future__ import annotations

import signal
import socket
import threading
from typing import TYPE_CHECKING, Annotated

import typer

from lbacal.engine import HERE, Engine, read_address
from lbacal_core.errors import LbacalError, write_count

if TYPE_CHECKING:
    from service.factory import Factory


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
        print(f"{write_count(len(look_for_due_work(factory)), 'job')} enqueued")
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
    from service.cli.opening import open_factory
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
