"""Scheduler and worker as one process, the child of `lbacal serve`; it ends when its standard input does."""

from __future__ import annotations

import os
import signal
import sys
import threading

import structlog

from lbacal.engine import Engine, read_address
from lbacal_core.errors import LbacalError
from service.cli.opening import open_factory
from service.factory import Factory
from service.scheduler import run_scheduler
from service.worker import Worker

log = structlog.get_logger()


def main() -> None:
    """Run until the parent closes the pipe, or dies in whatever way."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which then closes the pipe
    stop = threading.Event()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        factory = open_factory(Engine(read_address()))
    except LbacalError as error:
        log.error("scheduler and worker cannot start", error=str(error))  # noqa: TRY400 - the sentence says it all
        sys.exit(1)
    threading.Thread(target=_schedule, args=(factory, stop), daemon=True).start()
    Worker(factory).run(stop)


def _schedule(factory: Factory, stop: threading.Event) -> None:
    """Run the scheduler; without it this process is worth nothing, and the parent starts a new one."""
    try:
        run_scheduler(factory, stop)
    except BaseException:
        # the top of a thread whose end nobody would see
        log.exception("the scheduler ended")
        os._exit(1)


def _end_with_parent() -> None:
    # not through sys.stdin, whose lock would abort an interpreter that ends while this waits
    while os.read(0, 4096):
        pass
    # at once: a part begun is not lost, its lease passes to the next worker
    os._exit(0)


if __name__ == "__main__":
    main()
