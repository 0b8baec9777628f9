"""Whether the service can serve, and what an operator looks at first: processes, work, failures, age of the data."""

from __future__ import annotations

import os
import secrets
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import structlog

from lbacal.instants import DAY_US, SECOND_US
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.errors import LbacalError, write_count
from lbacal_core.instrument.instrument import Instrument
from service.errors import UnavailableError
from service.storage.database import FULL, Database
from service.storage.jobs import Failure
from service.storage.ledger import pick_answering
from service.storage.migration import require_current
from service.storage.processes import WORKER, Process
from service.storage.versions import Version
from service.usecases.alarms import AlarmCounts, count_alarms
from service.usecases.calibrations import select_paths
from service.usecases.orders import explain_difference

ROOM_BYTES = 16_000_000
"""With less room than this on its disk, an SQLite file counts as unable to grow."""
ENDED_SINCE_US = 30 * DAY_US
"""Parts of jobs that ended earlier are not counted, and failures not shown."""
FAILURES_SHOWN = 50


@dataclass(frozen=True)
class State:
    """The status for an operator. `problem` is why the service is not ready; None if it is."""

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
        """Gather readiness, processes, parts of jobs, failures and alarms; an unready service is told, not raised."""
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
                gated=sum(one.is_to_decide for one in stores.versions.waiting()),
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


# The state of everything on one page.


@dataclass(frozen=True)
class StationState:
    """How many paths of a station are calibrated at the last event, and how many of them by their own version.

    A path counts if its data are in the curve that it is served: its own version, or that of a mean to which it
    belongs.
    `without_data` are served the mean of others.
    """

    name: str
    paths: int
    in_effect: int
    own: int
    without_data: int


@dataclass(frozen=True)
class Overview:
    """The first and the last event, and stations."""

    first: Instant | None
    last: Instant | None
    stations: Sequence[StationState]

    @property
    def paths(self) -> int:
        """Paths of the instrument."""
        return sum(station.paths for station in self.stations)

    @property
    def without_data(self) -> int:
        """Paths without data of their own, which are served the mean of others."""
        return sum(station.without_data for station in self.stations)

    @property
    def paths_in_effect(self) -> int:
        """Paths with data in the version in effect at the last event."""
        return sum(station.in_effect for station in self.stations)


def look_over(database: Database, instrument: Instrument, clock: Callable[[], Instant]) -> Overview:
    """Count the paths of each station on record that have a version in effect at the last event."""
    with database.read() as stores:
        span = stores.spectra.span()
        at = clock() if span is None else span[1]
        on_record = {(one.station, one.antenna) for one in instrument.antennas if one.covers(at / SECOND_US)}
        paths = [one for one in select_paths(instrument, None, None, None) if one.parts[:2] in on_record]
        last = pick_answering(stores.ledger.answers(paths, at, None))
        wide = {str(promotion.calibration) for promotion in last.values() if promotion.scope.antenna is None}
        versions = stores.versions.get_many(wide)
        own = {path for path, promotion in last.items() if promotion.scope.antenna is not None}
        averaged = {
            path for path in last if path not in own and _is_member(versions[str(last[path].calibration)], path)
        }
        stations = []
        for name in sorted({str(path.station) for path in paths}):
            of_station = {path for path in paths if path.station == name}
            with_data = of_station & (own | averaged)
            told = of_station & set(last)
            stations.append(
                StationState(name, len(of_station), len(with_data), len(of_station & own), len(told - with_data))
            )
        return Overview(span[0] if span else None, span[1] if span else None, stations)


def _is_member(version: Version, path: Scope) -> bool:
    """Whether a path is one of those whose mean a version is."""
    chain = version.chains.get(str(path.dipole))
    return chain is not None and (path.station, path.antenna) in chain.member_set


def tell_problems(state: State, overview: Overview, stopped: Sequence[str]) -> list[str]:
    """List the problems, the worst first; empty where there is none."""
    found = [] if state.problem is None else [f"The service is not ready: {state.problem}."]
    found += [f"{sentence}." for sentence in state.stuck]
    silent = overview.paths - overview.paths_in_effect - overview.without_data
    if overview.last is None:
        found.append("No spectra are stored yet.")
    elif silent:
        found.append(f"Paths without a calibration in effect at the last event: {silent} of {overview.paths}.")
    if state.alarms.open:
        found.append(f"Alarms: {state.alarms.line}.")
    if state.failures:
        found.append(f"{write_count(len(state.failures), 'job')} failed and nothing has made up for it.")
    return [*found, *(f"No longer pays: {sentence}" for sentence in stopped)]


# A process records that it lives, every few seconds, for as long as its work runs.

BEAT_S = 5.0
log = structlog.get_logger()


def name_process() -> str:
    """A name that no other process has, even in two containers with one host name and number."""
    return f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(3)}"


@dataclass
class Pulse:
    """Beats between entering and leaving; a beat that fails is tried again at the next."""

    database: Database
    kind: str
    inputs: str | None = None
    name: str = field(default_factory=name_process)
    _stop: threading.Event = field(default_factory=threading.Event, repr=False)

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        try:
            with self.database.write() as stores:
                stores.processes.leave(self.name)
        except LbacalError as error:
            log.warning("end not noted", error=str(error))

    def beat(self) -> None:
        """Note that the process lives."""
        try:
            with self.database.write() as stores:
                stores.processes.see(self.name, self.kind, self.inputs)
        except LbacalError as error:
            log.warning("pulse not noted", error=str(error), detail=getattr(error, "detail", ""))

    def _run(self) -> None:
        self.beat()
        while not self._stop.wait(BEAT_S):
            try:
                self.beat()
            except Exception:
                # the process works on whether its pulse is noted or not
                log.exception("pulse not noted")
