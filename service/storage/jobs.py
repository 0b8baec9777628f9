"""Work asked for and due. A job is what somebody asked; its parts are what workers claim, each under a lease."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import and_, case, func, or_, select, update

from lbacal_core.curves.validity import Instant
from lbacal_core.provenance import canonical_json
from service.errors import ConflictError
from service.schema.tables import HAS_FAILED, HAS_SETTLED, IS_OPEN, job, job_part
from service.storage.processes import read_database_clock
from service.storage.rows import Store, from_row, insert_into, require_one, to_row

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
OPEN = (QUEUED, RUNNING)
MAX_ATTEMPTS = 10
"""A part whose workers died this often is given up: it would go on killing them."""
PAUSE_US = 600_000_000
"""After a failure due work is tried again in ten minutes, after each further one in twice the time."""
LONGEST_PAUSE_US = 86_400_000_000
"""At the latest it is tried again after a day, and work that somebody cancelled not before."""
GIVEN_UP = "given up: the scheduler has another instrument, sky power or model version by now"
"""The error of due parts that were never tried: with the inputs of now they are due at once."""


class LeaseLostError(ConflictError, code="lease_lost"):
    """The part is no longer this worker's: it was silent for too long, or the job was cancelled."""


@dataclass(frozen=True)
class Order:
    """A job to be made: who asked for what and why.

    `inputs` are those that a worker must have for it (`service.usecases.orders`). `due_name` names scheduled work,
    which is made until it is done, and then no more. `called_for` are the inputs that call for it, by name.
    """

    kind: str
    request: Mapping[str, Any]
    parts: Sequence[Mapping[str, Any]]
    reason: str
    by: str
    due_name: str | None = None
    inputs: str | None = None
    called_for: Mapping[str, Any] | None = None


Explain = Callable[[Mapping[str, Any] | None, Mapping[str, Any]], str]
"""Says why work is due: from the inputs of the same work before, None where there is none, and those of now."""


@dataclass(frozen=True)
class Part:
    """A piece of work as a worker sees it; `is_due` if nobody asked for it but the scheduler."""

    number: int
    job: int
    kind: str
    request: Mapping[str, Any]
    reason: str
    by: str
    is_due: bool = False


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


@dataclass(frozen=True)
class Record:
    """The record of a part: its worker, how often it was begun, and how it ended."""

    request: Mapping[str, Any]
    state: str
    worker: str | None
    attempts: int
    result: Mapping[str, Any]
    error: str | None
    ended: Instant | None


@dataclass(frozen=True)
class Tries:
    """The state of due work: open or done, or how often it failed, and when it may be tried again."""

    is_settled: bool
    failed: int
    again: Instant | None

    def is_due(self, now: Instant) -> bool:
        """Whether it is neither open nor done, and no pause after a failure lasts."""
        return not self.is_settled and (self.again is None or now >= self.again)


@dataclass(frozen=True)
class Failure:
    """A job that failed; for due work when it is tried again."""

    job: Job
    tries: Tries | None


class JobStore(Store):
    """Jobs are inserted; their parts go from queued to running to done or failed."""

    def add(self, order: Order, now: Instant, explain: Explain | None = None) -> int | None:
        """Make a job; None for due work that is done, open, or failed too shortly ago."""
        key = order.due_name
        if key is not None:
            tries = self._tries(key)
            if not tries.is_due(now):
                return None
            key = f"{key}.{tries.failed}" if tries.failed else key
        request = canonical_json(order.request)
        called_for = None if order.called_for is None else canonical_json(order.called_for)
        if explain is not None and called_for is not None:
            order = replace(order, reason=explain(self.called_for(order), json.loads(called_for)))
        more = {"created_us": now, "due_key": key, "is_cancelled": False, "called_for": called_for}
        row = to_row(order, job, request=request, **more)
        statement = insert_into(self._connection, job).values(row)
        statement = statement.on_conflict_do_nothing(index_elements=["due_key"]).returning(job.c.id)
        number = self._connection.execute(statement).scalar_one_or_none()
        if number is None:
            return None
        of_part = {"job": number, "inputs": order.inputs, "state": QUEUED, "attempts": 0}
        parts = [{**of_part, "request": canonical_json(part)} for part in order.parts]
        self._connection.execute(job_part.insert(), parts)
        return int(number)

    def is_due(self, order: Order, now: Instant) -> bool:
        """Whether `add` would make a job."""
        return order.due_name is None or self._tries(order.due_name).is_due(now)

    def called_for(self, order: Order) -> dict[str, Any] | None:
        """The inputs that made the same work due before; None if it never was."""
        same = select(job.c.called_for).where(job.c.kind == order.kind, job.c.request == canonical_json(order.request))
        last = same.where(job.c.called_for.is_not(None)).order_by(job.c.id.desc()).limit(1)
        before = self._connection.execute(last).scalar_one_or_none()
        return None if before is None else json.loads(before)

    def _tries(self, due_name: str) -> Tries:
        """What became of due work so far, since the same work was last done under another name.

        What is again what it was once is not done: a cause that was withdrawn changes other years back.
        """
        columns = [job.c.id, job.c.kind, job.c.request, job.c.is_cancelled]
        columns += [job_part.c.state, job_part.c.ended_us, job_part.c.error]
        statement = select(*columns).join(job_part, job_part.c.job == job.c.id).where(job.c.due_name == due_name)
        rows = self._connection.execute(statement).all()
        done = max((row for row in rows if row.state == DONE), key=lambda row: row.id, default=None)
        if any(row.state in OPEN for row in rows) or (done is not None and not self._is_done_since(done, due_name)):
            return Tries(is_settled=True, failed=0, again=None)
        tried = [row for row in rows if row.error != GIVEN_UP and (done is None or row.id > done.id)]
        failed = len({row.id for row in tried})
        pause = min(PAUSE_US * 2 ** min(failed - 1, 30), LONGEST_PAUSE_US) if failed else 0
        ends = [row.ended_us + (LONGEST_PAUSE_US if row.is_cancelled else pause) for row in tried]
        return Tries(is_settled=False, failed=len({row.id for row in rows}), again=max(ends, default=None))

    def _is_done_since(self, done: Any, due_name: str) -> bool:
        """Whether the same work was done under another name after a job."""
        statement = select(job.c.id).join(job_part, job_part.c.job == job.c.id).where(job_part.c.state == DONE)
        same = (job.c.kind == done.kind) & (job.c.request == done.request) & (job.c.id > done.id)
        return self._connection.execute(statement.where(same, job.c.due_name != due_name).limit(1)).first() is not None

    def claim(self, worker: str, *, lease_us: int, inputs: str | None = None) -> Part | None:
        """Take a part that is queued, or whose worker was silent for longer than its lease; None where there is none.

        Parts that need other inputs than the worker's are left to others: without `inputs` those that need any. Due
        work comes first: however much somebody asks for, the night is not behind it; and of it what C follows from,
        before investigations. Jobs that were asked for take turns, so that nobody waits for all of a large one. Leases
        are counted by the database's clock.
        """
        now = read_database_clock(self._connection)
        is_abandoned = and_(job_part.c.state == RUNNING, job_part.c.lease_until_us < now)
        free = select(job_part.c.id, job_part.c.attempts).join(job, job.c.id == job_part.c.job)
        free = free.where(IS_OPEN, or_(job_part.c.state == QUEUED, is_abandoned))
        free = free.where(or_(job_part.c.inputs.is_(None), job_part.c.inputs == inputs))
        own = job_part.alias()
        first = select(func.min(own.c.id)).where(own.c.job == job.c.id).scalar_subquery()
        turn = job.c.due_name.is_(None), job.c.kind == "investigation", job_part.c.id - first, job_part.c.id
        free = free.order_by(*turn).limit(1)
        found = self._connection.execute(free.with_for_update(skip_locked=True, of=job_part)).one_or_none()
        if found is None:
            return None
        of_part = job_part.c.id == found.id
        if found.attempts >= MAX_ATTEMPTS:
            error = f"given up: {found.attempts} workers died on it"
            change = update(job_part).where(of_part).values(state=FAILED, error=error, ended_us=now, worker=None)
            self._connection.execute(change)
            return self.claim(worker, lease_us=lease_us, inputs=inputs)
        taken = {"state": RUNNING, "worker": worker, "lease_until_us": now + lease_us, "attempts": found.attempts + 1}
        self._connection.execute(update(job_part).where(of_part).values(taken))
        columns = [job_part.c.id.label("number"), job_part.c.job, job_part.c.request]
        columns += [job.c.kind, job.c.reason, job.c.by, job.c.due_name.is_not(None).label("is_due")]
        row = self._connection.execute(select(*columns).join(job, job.c.id == job_part.c.job).where(of_part)).one()
        return from_row(Part, row, request=json.loads(row.request))

    def renew(self, part: Part, worker: str, *, lease_us: int) -> None:
        """Tell that the worker lives."""
        self._change(part, worker, lease_until_us=read_database_clock(self._connection) + lease_us)

    def complete(
        self, part: Part, worker: str, result: Mapping[str, Any], now: Instant, read: Order | None = None
    ) -> None:
        """Write the end of a part, in the transaction that writes its results: both happen once or not at all.

        Due work is done under the name of what it read, which may be another than when it was enqueued.
        """
        self._change(part, worker, state=DONE, result=canonical_json(result), ended_us=now, worker=None)
        if read is not None:
            name = {"due_name": read.due_name, "due_key": f"{read.due_name}@{part.job}"}
            is_other = (job.c.id == part.job) & (job.c.due_name != read.due_name)
            called_for = canonical_json(read.called_for)
            self._connection.execute(update(job).where(is_other).values(**name, called_for=called_for))

    def fail(self, part: Part, worker: str, error: str, now: Instant) -> None:
        """Write why a part cannot be done."""
        self._change(part, worker, state=FAILED, error=error, ended_us=now, worker=None)

    def _change(self, part: Part, holder: str, **values: Any) -> None:
        is_held = and_(job_part.c.id == part.number, job_part.c.state == RUNNING, job_part.c.worker == holder)
        if self._connection.execute(update(job_part).where(is_held).values(values)).rowcount == 0:
            raise LeaseLostError(f"part {part.number} of job {part.job} is no longer held by {holder}")

    def cancel(self, number: int, now: Instant, by: str, reason: str | None) -> None:
        """Stop a job: parts not yet done are dropped, running ones lose their lease. One that has ended stays so."""
        if (state := self.get(number).state) in (DONE, FAILED):
            raise ConflictError(f"job {number} is {state}: what it made is stored, and nothing is left to stop")
        why = f"cancelled by {by}" + (f": {reason}" if reason else "")
        values = {"state": CANCELLED, "ended_us": now, "error": why}
        open_parts = and_(job_part.c.job == number, job_part.c.state.in_(OPEN))
        self._connection.execute(update(job_part).where(open_parts).values(values))
        self._connection.execute(update(job).where(job.c.id == number).values(is_cancelled=True))

    def drop_outdated(self, inputs: str, now: Instant) -> int:
        """Give up due parts that nobody has begun and that were made for other inputs; return their count."""
        due = select(job.c.id).where(job.c.due_name.is_not(None))
        is_outdated = and_(IS_OPEN, job_part.c.state == QUEUED, job_part.c.inputs != inputs, job_part.c.job.in_(due))
        values = {"state": FAILED, "ended_us": now, "error": GIVEN_UP}
        return self._connection.execute(update(job_part).where(is_outdated).values(values)).rowcount

    def end_failures(self, kinds: Sequence[str], called: Collection[str | None]) -> None:
        """Cancel due jobs of some kinds that failed and are not called for, by their due names."""
        failed = select(job_part.c.job).where(HAS_FAILED, job_part.c.error != GIVEN_UP)
        is_due = and_(job.c.kind.in_(kinds), job.c.due_name.is_not(None), ~job.c.is_cancelled)
        statement = select(job.c.id, job.c.due_name).where(is_due, job.c.id.in_(failed))
        moot = [row.id for row in self._connection.execute(statement) if row.due_name not in called]
        if moot:
            self._connection.execute(update(job).where(job.c.id.in_(moot)).values(is_cancelled=True))

    def get(self, number: int) -> Job:
        """Get one job by its number; `NotFoundError` for an unknown one."""
        return require_one(self._with_parts([number]), f"no job {number}; GET /v1/jobs lists them")

    def records(self, number: int) -> list[Record]:
        """The parts of a job, in their order."""
        rows = self._connection.execute(select(job_part).where(job_part.c.job == number).order_by(job_part.c.id))
        return [
            from_row(Record, row, request=json.loads(row.request), result=json.loads(row.result or "{}"))
            for row in rows
        ]

    def newest(self, *, before: int | None = None, limit: int = 100) -> list[Job]:
        """Jobs from the newest back, those with a number below `before`."""
        statement = select(job.c.id).order_by(job.c.id.desc()).limit(limit)
        if before is not None:
            statement = statement.where(job.c.id < before)
        return self._with_parts(list(self._connection.execute(statement).scalars()))

    def count_open(self, by: str | None = None) -> int:
        """How many parts wait or run, all or those that somebody asked for."""
        statement = select(func.count()).select_from(job_part).where(IS_OPEN)
        if by is not None:
            statement = statement.join(job, job.c.id == job_part.c.job).where(job.c.by == by)
        return int(self._connection.execute(statement).scalar_one())

    def is_open(self, kind: str) -> bool:
        """Whether a part of some kind of job (``refit``, ``investigation``, ``watch`` …) waits or runs."""
        statement = select(job_part.c.id).join(job, job.c.id == job_part.c.job).where(job.c.kind == kind)
        return self._connection.execute(statement.where(job_part.c.state.in_(OPEN)).limit(1)).first() is not None

    def waiting(self) -> dict[str | None, int]:
        """How many parts are queued, by the inputs that they need (None: any)."""
        statement = select(job_part.c.inputs, func.count().label("parts")).where(IS_OPEN, job_part.c.state == QUEUED)
        return {row.inputs: row.parts for row in self._connection.execute(statement.group_by(job_part.c.inputs))}

    def count_by_state(self, since: Instant) -> dict[str, int]:
        """How many parts wait or run, and how many ended at an instant or later, by state, such as ``queued``."""
        is_late = job_part.c.ended_us >= since
        counts: dict[str, int] = {}
        # one partial index each; grouped by state, SQLite would take the index of all states
        for condition, (one, other) in (
            (IS_OPEN, OPEN), (and_(HAS_SETTLED, is_late), (DONE, CANCELLED)), (and_(HAS_FAILED, is_late), (FAILED, "")),
        ):  # fmt: skip
            of_one = func.coalesce(func.sum(case((job_part.c.state == one, 1), else_=0)), 0)
            parts, first = self._connection.execute(select(func.count(), of_one).where(condition)).one()
            counts |= {one: int(first), other: int(parts) - int(first)}
        return {state: counts[state] for state in (QUEUED, RUNNING, DONE, FAILED, CANCELLED)}

    def failures(self, since: Instant, limit: int) -> list[Failure]:
        """Jobs with a failed part, newest first; of due work the last try, and none if it was made up for."""
        later = job.alias()
        is_same = and_(later.c.id > job.c.id, later.c.request == job.c.request, later.c.kind == job.c.kind)
        made_up = select(later.c.id).where(is_same, later.c.due_name.is_not(None), job.c.due_name.is_not(None)).exists()
        failed = select(job_part.c.job).where(HAS_FAILED, job_part.c.ended_us >= since)
        statement = select(job.c.id, job.c.due_name).where(job.c.id.in_(failed), ~made_up, ~job.c.is_cancelled)
        rows = self._connection.execute(statement.order_by(job.c.id.desc()).limit(limit)).all()
        jobs = self._with_parts([row.id for row in rows])
        tries = {row.id: self._tries(row.due_name) if row.due_name else None for row in rows}
        return [Failure(one, tries[one.number]) for one in jobs]

    def _with_parts(self, numbers: Iterable[int]) -> list[Job]:
        numbers = list(numbers)
        parts: dict[int, list[Any]] = {number: [] for number in numbers}
        columns = [job_part.c.job, job_part.c.state, job_part.c.result, job_part.c.error]
        for row in self._connection.execute(
            select(*columns).where(job_part.c.job.in_(numbers)).order_by(job_part.c.id)
        ):
            parts[row.job].append(row)
        jobs = {
            row.id: from_row(
                Job, row, number=row.id, request=json.loads(row.request),
                states=tuple(part.state for part in parts[row.id]),
                results=tuple(json.loads(part.result) for part in parts[row.id] if part.result),
                errors=tuple(dict.fromkeys(part.error for part in parts[row.id] if part.error)),
            )
            for row in self._connection.execute(select(job).where(job.c.id.in_(numbers)))
        }  # fmt: skip
        return [jobs[number] for number in numbers if number in jobs]
