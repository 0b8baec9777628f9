"""Alarms: what is wrong, raised once, kept with who acknowledged it, ended when it is over."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_args

from sqlalchemy import Row, and_, func, or_, select, update

from lbacal.instants import format_instant
from lbacal_core.curves.validity import Instant, Scope, parse_scope
from lbacal_core.provenance import canonical_json
from service.schema.tables import alarm
from service.storage.changes import is_same_date
from service.storage.rows import Store, equal, from_row, require_one, scope_columns, to_row
from service.wire.answer_models import AlarmKind

STEP = "step"
SLOPE = "slope"
LOST_PATH = "lost_path"
LEFT_OUT = "left_out"
LOST_C = "lost_c"
RETRACTED = "retracted"
STALE_DATA = "stale_data"
MISFIT = "misfit"
CAUSE_STOPPED_PAYING = "cause_stopped_paying"
NAMED_CAUSE = "named_cause"
FAILED_JOB = "failed_job"
KINDS: tuple[str, ...] = get_args(AlarmKind)

OPEN, ACKNOWLEDGED, ENDED = "open", "acknowledged", "ended"
STATES = (OPEN, ACKNOWLEDGED, ENDED)


@dataclass(frozen=True)
class News:
    """A problem in its state at the latest look.

    Attributes
    ----------
    kind
        One of `KINDS`.
    scope
        Whom it concerns.
    subject
        Tells problems of the same kind and scope apart: a job's work, a model's cause.
    sentence
        What is wrong, for a human, in one line.
    content
        The numbers, as JSON values.
    since, since_error
        When it began and the standard deviation of that, microseconds; another run may date it a little differently.
    """

    kind: str
    scope: Scope
    subject: str
    sentence: str
    content: Mapping[str, Any] = field(default_factory=dict)
    since: Instant | None = None
    since_error: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"{self.kind!r} is not one of {KINDS}")


@dataclass(frozen=True)
class Acknowledgement:
    """A person's acknowledgement of an alarm, with the reason, and until when; None is for good."""

    by: str
    at: Instant
    reason: str
    until: Instant | None


@dataclass(frozen=True)
class Alarm:
    """A problem since the run that raised it; `ended` None while it lasts."""

    number: int
    news: News
    raised: Instant
    seen: Instant
    ended: Instant | None
    acknowledgement: Acknowledgement | None

    def state_at(self, now: Instant) -> str:
        """One of `STATES`: an acknowledgement that has run out leaves the alarm open."""
        if self.ended is not None:
            return ENDED
        known = self.acknowledgement
        return OPEN if known is None or (known.until is not None and known.until <= now) else ACKNOWLEDGED


class Doubt(NamedTuple):
    """A warning about C since an instant: of a path, or of a version wherever it answers."""

    of: Scope | str
    since: Instant
    warning: str


@dataclass(frozen=True)
class AlarmsAsked:
    """Which alarms are listed: those in some states; of a kind, a station, below a number where these are given."""

    states: Collection[str]
    limit: int
    kind: str | None = None
    station: str | None = None
    before: int | None = None


class AlarmStore(Store):
    """Alarms, each raised once."""

    def raise_alarm(self, news: News, now: Instant) -> int:
        """Raise an alarm, or see the one again that this problem has; its number."""
        return self._see(news, self._of([news.kind], news.scope.key), set(), now)

    def settle(self, kinds: Collection[str], present: Sequence[News], now: Instant) -> list[int]:
        """Take in the complete list of what is wrong of some kinds: the numbers of the alarms that are new.

        What is there already is seen again, what is gone has ended.
        """
        known = self._of(kinds)
        before = {one.number for one in known}
        used: set[int] = set()
        for news in present:
            used.add(self._see(news, known, used, now))
        gone = [one.number for one in known if one.ended is None and one.number not in used]
        if gone:
            self._connection.execute(update(alarm).where(alarm.c.id.in_(gone)).values(ended_us=now))
        return sorted(used - before)

    def acknowledge(self, number: int, acknowledgement: Acknowledgement) -> Alarm:
        """Record that somebody knows of an alarm; the last acknowledgement counts."""
        self.get(number)
        row = {
            "known_by": acknowledgement.by, "known_us": acknowledgement.at, "known_why": acknowledgement.reason,
            "known_until_us": acknowledgement.until,
        }  # fmt: skip
        self._connection.execute(update(alarm).where(alarm.c.id == number).values(row))
        return self.get(number)

    def get(self, number: int) -> Alarm:
        """Get one alarm; `NotFoundError` for an unknown number."""
        rows = self._connection.execute(select(alarm).where(alarm.c.id == number))
        return _value(require_one(rows, f"no alarm {number}; GET /v1/alarms lists them"))

    def newest(self, asked: AlarmsAsked, now: Instant) -> list[Alarm]:
        """Alarms in some states, newest first."""
        in_states = or_(*(_in_state(state, now) for state in asked.states))
        statement = select(alarm).where(in_states, *equal(alarm, kind=asked.kind, station=asked.station))
        if asked.before is not None:
            statement = statement.where(alarm.c.id < asked.before)
        statement = statement.order_by(alarm.c.id.desc()).limit(asked.limit)
        return [_value(row) for row in self._connection.execute(statement)]

    def doubts(self) -> list[Doubt]:
        """The paths all of whose newest spectra are left out of fits, and versions whose events are flagged since."""
        found = list[Doubt]()
        for news in (one.news for one in self._of([LEFT_OUT, RETRACTED]) if one.ended is None):
            if news.kind == RETRACTED:
                found += [Doubt(name, news.since or 0, why) for name, why in news.content["versions"].items()]
                continue
            since, spectra = news.since or 0, news.content["spectra"]
            all_of, day = f"all {spectra} spectra since", format_instant(since)[:10]
            warning = f"{all_of} {day} are left out as anomalous: C in effect is that of before"
            found += [Doubt(parse_scope(key), since, warning) for key in news.content["paths"]]
        return found

    def count(self, now: Instant, state: str) -> dict[str, int]:
        """How many there are in one of `STATES`, by kind."""
        statement = select(alarm.c.kind, func.count()).where(_in_state(state, now)).group_by(alarm.c.kind)
        return {kind: int(count) for kind, count in self._connection.execute(statement.order_by(alarm.c.kind))}

    def count_raised(self, since: Instant) -> int:
        """How many were raised after an instant and still last."""
        statement = select(func.count()).select_from(alarm).where(alarm.c.raised_us > since, alarm.c.ended_us.is_(None))
        return int(self._connection.execute(statement).scalar_one())

    def _of(self, kinds: Iterable[str], scope: str | None = None) -> list[Alarm]:
        asked = alarm.c.kind.in_(list(kinds)), *equal(alarm, scope=scope)
        return [_value(row) for row in self._connection.execute(select(alarm).where(*asked).order_by(alarm.c.id))]

    def _see(self, news: News, known: Sequence[Alarm], used: set[int], now: Instant) -> int:
        """Update the alarm of a problem, or make one."""
        same = [one for one in known if one.number not in used and _is_same(one.news, news)]
        own = {**scope_columns(news.scope), "content": canonical_json(news.content)}
        told = to_row(news, alarm, **own, seen_us=now, ended_us=None)
        if same:
            number = min(same, key=lambda one: _distance(one.news, news)).number
            self._connection.execute(update(alarm).where(alarm.c.id == number).values(told))
            return number
        made = self._connection.execute(alarm.insert().values({**told, "raised_us": now}).returning(alarm.c.id))
        return int(made.scalar_one())


def _is_same(one: News, other: News) -> bool:
    if (one.kind, one.scope, one.subject) != (other.kind, other.scope, other.subject):
        return False
    if one.since is None or other.since is None:
        return one.since is other.since
    return is_same_date((one.since, one.since_error), (other.since, other.since_error))


def _distance(one: News, other: News) -> int:
    return 0 if one.since is None or other.since is None else abs(one.since - other.since)


def _in_state(state: str, now: Instant) -> Any:
    known = and_(alarm.c.known_us.is_not(None), or_(alarm.c.known_until_us.is_(None), alarm.c.known_until_us > now))
    lasts = alarm.c.ended_us.is_(None)
    return {OPEN: and_(lasts, ~known), ACKNOWLEDGED: and_(lasts, known), ENDED: ~lasts}[state]


def _value(row: Row[Any]) -> Alarm:
    scope = Scope(row.station, row.antenna, row.dipole)
    news = from_row(News, row, scope=scope, content=json.loads(row.content))
    known = (
        None if row.known_us is None else Acknowledgement(row.known_by, row.known_us, row.known_why, row.known_until_us)
    )
    return from_row(Alarm, row, number=row.id, news=news, acknowledgement=known)
