"""The scheduler: looks for due work when it starts and every night after, and enqueues it; it does none itself."""

from __future__ import annotations

import threading
from datetime import UTC

import structlog
from apscheduler.schedulers.background import BackgroundScheduler
from apscheduler.triggers.cron import CronTrigger

from service.errors import UnavailableError
from service.factory import Factory

log = structlog.get_logger()


def look_for_due_work(factory: Factory) -> list[int]:
    """Enqueue what is due; looking twice enqueues it once."""
    jobs = factory.due.enqueue()
    log.info("looked for due work", enqueued=len(jobs))
    return jobs


def run_scheduler(factory: Factory, stop: threading.Event) -> None:
    """Look for due work now, which makes up for any night missed, and then nightly until told to stop."""

    def look() -> None:
        while not stop.is_set():
            try:
                look_for_due_work(factory)
            except UnavailableError as error:
                log.warning("database away", error=str(error))
                stop.wait(factory.settings.poll_s)
            else:
                return

    hour, minute = factory.settings.nightly_utc.split(":")
    # no grace time: a night missed by a second or an hour is made up for, once
    scheduler = BackgroundScheduler(timezone=UTC, job_defaults={"coalesce": True, "misfire_grace_time": None})
    scheduler.add_job(look, CronTrigger(hour=hour, minute=minute, timezone=UTC), max_instances=1)
    look()
    scheduler.start()
    stop.wait()
    scheduler.shutdown()
