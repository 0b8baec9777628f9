"""The worker: claims parts one by one, does them, and records meanwhile that it lives.

With dask it holds as many parts at once as its engine has slots. What is computed is sent there, arrays in and values
out; the leases, what is read and what is written stay here, so that a process that dies there changes nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

import structlog
from threadpoolctl import threadpool_limits

from lbacal.engine import EngineAwayError
from lbacal_core.errors import LbacalError
from service.errors import UnavailableError
from service.factory import Factory
from service.storage.jobs import LeaseLostError, Part
from service.storage.processes import WORKER
from service.usecases.alarms import describe_failed
from service.usecases.drift_measurement import KIND as DRIFT
from service.usecases.investigations import KIND as INVESTIGATION
from service.usecases.orders import explain_difference
from service.usecases.refits import KIND as REFIT
from service.usecases.status import Pulse, name_process
from service.usecases.watch import KIND as WATCH

log = structlog.get_logger()
RENEWALS = 4
"""How often a lease is renewed within its time."""
MOST_AT_ONCE = 24
"""Parts that one worker holds, however large its cluster is: the spectra of a station's year are 35 MB."""


class Worker:
    """Does parts of jobs, for as long as there are any or until it is stopped."""

    def __init__(self, factory: Factory, name: str | None = None) -> None:
        self._factory = factory
        self._inputs = factory.inputs.text
        self._name = name or name_process()
        self._left: dict[str, int] = {}
        self._deeds: dict[str, Callable[[Part, str], None]] = {
            REFIT: factory.refits.run,
            DRIFT: factory.drift_measurement.run,
            INVESTIGATION: factory.investigations.run,
            WATCH: factory.watch.run,
        }
        self._lease_us = round(factory.settings.lease_s * 1e6)

    def run(self, stop: threading.Event, *, until_idle: bool = False) -> None:
        """Work until asked to stop, or with `until_idle` until nothing is left to claim, or the database is away."""
        poll_s, begun = self._factory.settings.poll_s, set[Future[None]]()
        with (
            threadpool_limits(1),
            Pulse(self._factory.database, WORKER, self._inputs, self._name),
            ThreadPoolExecutor(MOST_AT_ONCE) as lanes,
        ):
            while not stop.is_set():
                try:
                    begun = _take_ended(begun)
                    if len(begun) < min(self._factory.engine.slots, MOST_AT_ONCE):
                        with self._factory.database.write() as stores:
                            part = stores.jobs.claim(self._name, lease_us=self._lease_us, inputs=self._inputs)
                        if part is not None:
                            begun.add(lanes.submit(self._do, part))
                            continue
                        if not begun:
                            self._tell_what_is_left()
                except UnavailableError as error:
                    if until_idle:
                        raise
                    log.warning("database away", error=str(error))
                if begun:
                    wait(begun, poll_s, FIRST_COMPLETED)
                elif until_idle:
                    return
                else:
                    stop.wait(poll_s)

    def _tell_what_is_left(self) -> None:
        """Say once of parts that were made for other inputs that this worker refuses them."""
        with self._factory.database.read() as stores:
            waiting = stores.jobs.waiting()
        left = {needed: count for needed, count in waiting.items() if needed is not None and needed != self._inputs}
        if left != self._left:
            for needed, count in left.items():
                log.warning("parts refused", parts=count, needed=explain_difference(needed, self._inputs))
        self._left = left

    def _do(self, part: Part) -> None:
        told = log.bind(job=part.job, part=part.number, kind=part.kind)
        told.info("part begins", request=dict(part.request))
        try:
            with self._alive(part):
                self._deeds[part.kind](part, self._name)
            told.info("part done")
        except (UnavailableError, EngineAwayError):
            raise  # the lease runs out, and the part passes to whoever has a database and an engine
        except LeaseLostError as error:
            told.warning("part given up", error=str(error))
        except LbacalError as error:
            self._fail(part, str(error))
        except Exception as error:  # noqa: BLE001 - one part that fails in a new way must not stop the worker
            told.exception("part failed unexpectedly")
            self._fail(part, f"unexpected {type(error).__name__}: {error}")
        else:
            self._factory.due.enqueue_next(part)
            if part.kind == WATCH or (part.kind == REFIT and part.request["scope"] == "array"):
                # the last of the refits, and of the drift: what a night found is told when it is over
                self._factory.alarms.look()

    def _fail(self, part: Part, reason: str) -> None:
        log.warning("part failed", job=part.job, part=part.number, error=reason)
        try:
            with self._factory.database.write() as stores:
                stores.jobs.fail(part, self._name, reason, self._factory.clock())
                if part.is_due:  # whoever asked for it is told by the job
                    stores.alarms.raise_alarm(describe_failed(stores.jobs.get(part.job), reason), self._factory.clock())
        except LeaseLostError as error:
            log.warning("part given up", error=str(error))

    @contextmanager
    def _alive(self, part: Part) -> Iterator[None]:
        """Renew the lease of a part while the block runs."""
        is_done = threading.Event()

        def renew() -> None:
            while not is_done.wait(self._factory.settings.lease_s / RENEWALS):
                try:
                    with self._factory.database.write() as stores:
                        stores.jobs.renew(part, self._name, lease_us=self._lease_us)
                except LbacalError as error:
                    # a lost lease shows when the part ends; a database that is away may be back by then
                    log.warning("lease not renewed", part=part.number, error=str(error))

        thread = threading.Thread(target=renew, daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_done.set()
            thread.join()


def _take_ended(begun: set[Future[None]]) -> set[Future[None]]:
    """Parts that are not yet done; what stopped one that is raises here."""
    ended = {one for one in begun if one.done()}
    begun -= ended
    for one in ended:
        one.result()
    return begun
