"""The scheduler: looks for due work when it starts and daily after, and enqueues it; it does none itself.

No look but one that is ordered (`--once`) begins while a campaign is arriving.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime

import structlog
from apscheduler.schedulers.background import BackgroundScheduler
from apscheduler.triggers.cron import CronTrigger
from apscheduler.triggers.interval import IntervalTrigger

from service.errors import UnavailableError
from service.factory import Factory
from service.storage.processes import SCHEDULER
from service.usecases.status import Pulse

log = structlog.get_logger()
AGAIN_S = 600
"""How often failed work is looked at: the shortest pause before it is tried again."""
MOST_WAITS = 6
"""Events that arrive all the time hold no night up for longer than so many times the quiet that is waited for."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0


def look_for_due_work(factory: Factory) -> list[int]:
    """Enqueue what is due, and raise the alarms of what the database tells; looking twice does both once."""
    jobs = factory.due.enqueue()
    raised = factory.alarms.look()
    log.info("looked for due work", enqueued=len(jobs), alarms=len(raised))
    return jobs


def look_again(factory: Factory) -> list[int]:
    """Enqueue failed work whose pause is over, without waiting for the daily run."""
    return look_for_due_work(factory) if factory.due.has_failed_lately() else []


def run_scheduler(factory: Factory, stop: threading.Event) -> None:
    """Look for due work once nothing arrives, which makes up for missed days, and then daily until asked to stop."""

    def look() -> None:
        persist(lambda: wait_for_quiet(factory, stop), stop)
        persist(lambda: look_for_due_work(factory), stop)

    hour, minute = factory.settings.nightly_utc.split(":")
    # no grace time: a night missed by a second or an hour is made up for, once
    scheduler = BackgroundScheduler(timezone=UTC, job_defaults={"coalesce": True, "misfire_grace_time": None})
    daily = CronTrigger(hour=hour, minute=minute, timezone=UTC)
    scheduler.add_job(look, daily, max_instances=1, next_run_time=datetime.now(UTC))
    again = IntervalTrigger(seconds=AGAIN_S, timezone=UTC)
    scheduler.add_job(lambda: persist(lambda: look_again(factory), stop), again, max_instances=1)
    with Pulse(factory.database, SCHEDULER, factory.inputs.text):
        scheduler.start()
        stop.wait()
        scheduler.shutdown()


def wait_for_quiet(factory: Factory, stop: threading.Event) -> None:
    """Wait, `MOST_WAITS` times `quiet_s` at most, for a campaign that is being ingested: half would be fitted."""
    quiet_s = factory.settings.quiet_s
    for _ in range(MOST_WAITS):
        with factory.database.read() as stores:
            newest = stores.spectra.arrivals.newest()
        left_s = 0.0 if newest is None else quiet_s - (factory.clock() - newest) / 1e6
        if left_s <= 0:
            return
        log.info("spectra are arriving: the look for due work waits", quiet_s=quiet_s, left_s=round(left_s))
        if stop.wait(min(left_s, quiet_s)):
            return


def persist(look: Callable[[], object], stop: threading.Event) -> None:
    """Look until it succeeds, with ever longer pauses: whatever goes wrong in one look must not end all later ones."""
    pause = FIRST_PAUSE_S
    while not stop.is_set():
        try:
            look()
        except UnavailableError as error:
            log.warning("database away", error=str(error), detail=error.detail)
        except Exception:
            # the top of the scheduler's loop: an error nobody foresaw is logged, and the next look may succeed
            log.exception("look for due work failed")
        else:
            return
        stop.wait(pause)
        pause = min(2 * pause, LONGEST_PAUSE_S)
