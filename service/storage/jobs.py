"""Work asked for and due. A job is what somebody asked; its parts are what workers claim, each under a lease."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, and_, or_, select, update
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.provenance import canonical_json
from lbacal_core.validity import Instant
from service.errors import ConflictError, NotFoundError
from service.schema.tables import job, job_part

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
MAX_ATTEMPTS = 10
"""A part whose workers died this often is given up: it would go on killing them."""


class LeaseLostError(ConflictError):
    """The part is no longer this worker's: it was silent for too long, or the job was cancelled."""

    code = "lease_lost"


@dataclass(frozen=True)
class Order:
    """A job to be made: who asked for what and why. `due_key` names scheduled work, which is made once."""

    kind: str
    request: Mapping[str, Any]
    parts: Sequence[Mapping[str, Any]]
    reason: str
    by: str
    due_key: str | None = None


@dataclass(frozen=True)
class Part:
    """A piece of work as a worker sees it."""

    number: int
    job: int
    kind: str
    request: Mapping[str, Any]
    reason: str
    by: str


@dataclass(frozen=True)
class Job:
    """A job and how far it is."""

    number: int
    kind: str
    request: Mapping[str, Any]
    reason: str
    by: str
    created: Instant
    is_cancelled: bool
    states: Sequence[str]
    results: Sequence[Mapping[str, Any]]
    errors: Sequence[str]

    @property
    def state(self) -> str:
        """One word for all parts."""
        if self.is_cancelled:
            return CANCELLED
        if all(state == QUEUED for state in self.states):
            return QUEUED
        if any(state in (QUEUED, RUNNING) for state in self.states):
            return RUNNING
        return FAILED if FAILED in self.states else DONE

    @property
    def progress(self) -> float:
        """Fraction of the parts that were worked on to their end."""
        return sum(state in (DONE, FAILED) for state in self.states) / len(self.states)


class JobStore:
    """Jobs are inserted; their parts go from queued to running to done or failed."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def add(self, order: Order, now: Instant) -> int | None:
        """Make a job; None where the same due work was enqueued before."""
        row = {
            "kind": order.kind, "request": canonical_json(order.request), "reason": order.reason, "by": order.by,
            "created_us": now, "due_key": order.due_key, "is_cancelled": False,
        }  # fmt: skip
        statement = self._insert(job).values(row).on_conflict_do_nothing(index_elements=["due_key"]).returning(job.c.id)
        number = self._connection.execute(statement).scalar_one_or_none()
        if number is None:
            return None
        parts = [{"job": number, "request": canonical_json(p), "state": QUEUED, "attempts": 0} for p in order.parts]
        self._connection.execute(job_part.insert(), parts)
        return int(number)

    def claim(self, worker: str, *, now: Instant, lease_us: int) -> Part | None:
        """Take the oldest part that is queued, or whose worker has been silent for longer than its lease."""
        is_abandoned = and_(job_part.c.state == RUNNING, job_part.c.lease_until_us < now)
        free = select(job_part.c.id, job_part.c.attempts).where(or_(job_part.c.state == QUEUED, is_abandoned))
        free = free.order_by(job_part.c.id).limit(1).with_for_update(skip_locked=True)
        found = self._connection.execute(free).one_or_none()
        if found is None:
            return None
        of_part = job_part.c.id == found.id
        if found.attempts >= MAX_ATTEMPTS:
            error = f"given up: {found.attempts} workers died on it"
            change = update(job_part).where(of_part).values(state=FAILED, error=error, ended_us=now, worker=None)
            self._connection.execute(change)
            return self.claim(worker, now=now, lease_us=lease_us)
        taken = {"state": RUNNING, "worker": worker, "lease_until_us": now + lease_us, "attempts": found.attempts + 1}
        self._connection.execute(update(job_part).where(of_part).values(taken))
        statement = select(job_part.c.id, job_part.c.job, job.c.kind, job_part.c.request, job.c.reason, job.c.by)
        row = self._connection.execute(statement.join(job, job.c.id == job_part.c.job).where(of_part)).one()
        return Part(row.id, row.job, row.kind, json.loads(row.request), row.reason, row.by)

    def renew(self, part: Part, worker: str, *, now: Instant, lease_us: int) -> None:
        """Tell that the worker lives."""
        self._change(part, worker, lease_until_us=now + lease_us)

    def complete(self, part: Part, worker: str, result: Mapping[str, Any], now: Instant) -> None:
        """Write the end of a part, in the transaction that writes its results: both happen once or not at all."""
        self._change(part, worker, state=DONE, result=canonical_json(result), ended_us=now, worker=None)

    def fail(self, part: Part, worker: str, error: str, now: Instant) -> None:
        """Write why a part cannot be done."""
        self._change(part, worker, state=FAILED, error=error, ended_us=now, worker=None)

    def _change(self, part: Part, holder: str, **values: Any) -> None:
        is_held = and_(job_part.c.id == part.number, job_part.c.state == RUNNING, job_part.c.worker == holder)
        if self._connection.execute(update(job_part).where(is_held).values(values)).rowcount == 0:
            raise LeaseLostError(f"part {part.number} of job {part.job} is no longer held by {holder}")

    def cancel(self, number: int, now: Instant) -> None:
        """Stop a job: parts not yet done are dropped, running ones lose their lease. One that has ended stays so."""
        if (state := self.get(number).state) in (DONE, FAILED):
            raise ConflictError(f"job {number} is {state}: what it made is stored, and nothing is left to stop")
        self._connection.execute(update(job).where(job.c.id == number).values(is_cancelled=True))
        open_parts = and_(job_part.c.job == number, job_part.c.state.in_([QUEUED, RUNNING]))
        self._connection.execute(update(job_part).where(open_parts).values(state=CANCELLED, ended_us=now))

    def get(self, number: int) -> Job:
        """One job by its number."""
        found = self._with_parts([number])
        if not found:
            raise NotFoundError(f"no job {number}; GET /v1/jobs lists them")
        return found[0]

    def newest(self, *, before: int | None, limit: int) -> list[Job]:
        """Jobs from the newest back, those with a number below `before`."""
        statement = select(job.c.id).order_by(job.c.id.desc()).limit(limit)
        if before is not None:
            statement = statement.where(job.c.id < before)
        return self._with_parts(list(self._connection.execute(statement).scalars()))

    def count_open(self) -> int:
        """How many parts wait or run."""
        statement = select(job_part.c.id).where(job_part.c.state.in_([QUEUED, RUNNING]))
        return len(self._connection.execute(statement).all())

    def _with_parts(self, numbers: Iterable[int]) -> list[Job]:
        numbers = list(numbers)
        parts: dict[int, list[Any]] = {number: [] for number in numbers}
        columns = [job_part.c.job, job_part.c.state, job_part.c.result, job_part.c.error]
        for row in self._connection.execute(
            select(*columns).where(job_part.c.job.in_(numbers)).order_by(job_part.c.id)
        ):
            parts[row.job].append(row)
        jobs = {
            row.id: Job(
                row.id, row.kind, json.loads(row.request), row.reason, row.by, row.created_us, row.is_cancelled,
                tuple(part.state for part in parts[row.id]),
                tuple(json.loads(part.result) for part in parts[row.id] if part.result),
                tuple(part.error for part in parts[row.id] if part.error),
            )
            for row in self._connection.execute(select(job).where(job.c.id.in_(numbers)))
        }  # fmt: skip
        return [jobs[number] for number in numbers if number in jobs]
