"""`lbacal scheduler` and `lbacal worker`: what `lbacal serve` runs as a child, as processes of their own."""

from __future__ import annotations

import signal
import threading
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.factory import Factory


def scheduler(
    once: Annotated[bool, typer.Option("--once", help="Look for due work now, and end.")] = False,
) -> None:
    """Find due refits: now, which makes up for nights missed, and then every night. It enqueues, workers do.

    Example: lbacal scheduler
    """
    from service.scheduler import look_for_due_work, run_scheduler

    factory = _open()
    if once:
        print(f"{len(look_for_due_work(factory))} jobs enqueued")
        return
    run_scheduler(factory, _stop_on_signal())


def worker(
    until_idle: Annotated[bool, typer.Option("--until-idle", help="End when nothing is left to do.")] = False,
) -> None:
    """Do refits. Any number of workers may run, on any machine that reaches the database.

    Example: lbacal worker
    """
    from service.worker import Worker

    Worker(_open()).run(_stop_on_signal(), until_idle=until_idle)


def _open() -> Factory:
    from service.config import read_settings
    from service.factory import Factory
    from service.logs import configure_logs
    from service.storage.migration import require_current

    settings = read_settings()
    configure_logs(settings.log_level)
    factory = Factory(settings)
    require_current(factory.database)
    return factory


def _stop_on_signal() -> threading.Event:
    stop = threading.Event()
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: stop.set())
    return stop
