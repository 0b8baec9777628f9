"""Scheduler and worker as one process, the child of `lbacal serve`; it ends when its standard input does."""

from __future__ import annotations

import os
import signal
import sys
import threading

from service.config import read_settings
from service.factory import Factory
from service.logs import configure_logs
from service.scheduler import run_scheduler
from service.worker import Worker


def main() -> None:
    """Run until the parent closes the pipe, or dies in whatever way."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which then closes the pipe
    settings = read_settings()
    configure_logs(settings.log_level)
    stop = threading.Event()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    factory = Factory(settings)
    threading.Thread(target=run_scheduler, args=(factory, stop), daemon=True).start()
    Worker(factory).run(stop)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    # at once: a part begun is not lost, its lease passes to the next worker
    os._exit(0)


if __name__ == "__main__":
    main()
