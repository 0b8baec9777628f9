"""Whether the service can serve, and what an operator looks at first: processes, work, failures, age of the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import LbacalError
from service.errors import UnavailableError
from service.storage.database import Database
from service.storage.failures import FULL
from service.storage.jobs import Failure
from service.storage.migration import require_current
from service.storage.processes import WORKER, Process
from service.usecases.alarms import AlarmCounts, count_alarms
from service.usecases.inputs import explain_difference
from service.wire.instants import DAY_US

ROOM_BYTES = 16_000_000
"""With less room than this on its disk, an SQLite file counts as unable to grow."""
ENDED_SINCE_US = 30 * DAY_US
"""Parts of jobs that ended earlier are not counted, and failures not shown."""
FAILURES_SHOWN = 50


@dataclass(frozen=True)
class State:
    """What an operator looks at. `problem` is why the service is not ready; None if it is."""

    problem: str | None
    processes: Sequence[Process]
    parts: Mapping[str, int]
    stuck: Sequence[str]
    failures: Sequence[Failure]
    events: int
    newest_event: Instant | None
    gated: int
    alarms: AlarmCounts


@dataclass(frozen=True)
class Status:
    """Looks, and writes nothing."""

    database: Database
    clock: Callable[[], Instant]

    def require_ready(self) -> None:
        """Refuse, with the reason, while the database is away, full or of another schema, or no worker lives."""
        require_current(self.database)
        if self.database.write_failure is not None:
            raise self.database.write_failure
        room = self.database.free_bytes
        if room is not None and room < ROOM_BYTES:
            raise UnavailableError(FULL, f"{room} bytes are free")
        with self.database.read() as stores:
            processes = stores.processes.all()
        if not any(one.kind == WORKER and one.is_alive for one in processes):
            raise UnavailableError("no worker has lived for a minute: start `lbacal worker`")

    def look(self) -> State:
        """Gather everything."""
        try:
            self.require_ready()
            problem = None
        except LbacalError as error:
            problem = str(error)
        with self.database.read() as stores:
            processes = stores.processes.all()
            span = stores.spectra.span()
            return State(
                problem=problem,
                processes=processes,
                parts=stores.jobs.count_by_state(self.clock() - ENDED_SINCE_US),
                stuck=_explain_waiting(stores.jobs.waiting(), processes),
                failures=stores.jobs.failures(self.clock() - ENDED_SINCE_US, FAILURES_SHOWN),
                events=stores.spectra.count_events(),
                newest_event=None if span is None else span[1],
                gated=stores.versions.count_gated(),
                alarms=count_alarms(stores, self.clock()),
            )


def _explain_waiting(waiting: Mapping[str | None, int], processes: Sequence[Process]) -> list[str]:
    """List the parts that no living worker may begin, with the reason."""
    had = sorted({one.inputs for one in processes if one.kind == WORKER and one.is_alive and one.inputs})
    return [
        f"{count} parts wait for a worker with {explain_difference(needed, had[0])}"
        for needed, count in waiting.items()
        if needed is not None and had and needed not in had
    ]
