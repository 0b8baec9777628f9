"""Changes: what changed in paths, a station or the array and when, by what evidence, and what was decided about it.

One row, whoever found it: drift, an investigation, the instrument's record, a person. What drift found beyond the
threshold of an alarm, what is on record and what a person entered is in force at once; what an investigation alone
found is proposed until somebody decides. A change lasts while one of its sources says so. Nothing is deleted: evidence
that ended and every decision stay on record.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from sqlalchemy import Select, func, or_, select, true, update

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.calibration.slow_changes import SlowChange, spread_over_band
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.members import SAME_DATE
from lbacal_core.errors import name_path
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from service.schema.tables import change, change_decision, change_evidence
from service.storage.rows import Store, equal, from_row, require_one, to_row

KINDS = STEP, RAMP, SEASON, COURSE = "step", "ramp", "season", "course"
DRIFT, INVESTIGATION, RECORD, PERSON = "drift", "investigation", "record", "person"
PROPOSED, IN_FORCE, DISMISSED = "proposed", "in_force", "dismissed"
NOT_REFITTED = "found, not yet refitted"
MOVED_DATE = 2.0
"""Standard deviations by which a date moves: each move cuts windows anew."""
LARGEST_DATE_ERROR_US = 90 * DAY_US
"""A change whose date is known worse is told, and cuts no window. One that is cut some weeks off holds less of both
sides than one that is not cut."""


def is_same_date(one: tuple[Instant, Instant], other: tuple[Instant, Instant]) -> bool:
    """Whether two dates, each with its error, are one: they agree within a day and their errors."""
    return abs(one[0] - other[0]) <= SAME_DATE * math.hypot(one[1], other[1]) + DAY_US


PATH, DATED, SIZED = ("antenna", "dipole"), ("date", "sigma"), ("size", "size_sigma", "tilt", "curvature")


@dataclass(frozen=True)
class OwnSize:
    """The size by which a path changed where that is not the size of its change; fields as those of `Change`."""

    antenna: int
    dipole: str
    size: float
    size_sigma: float
    tilt: float | None = None
    curvature: float | None = None


@dataclass(frozen=True)
class Change:
    """A change: its date, target and size.

    Attributes
    ----------
    station
        None for the array.
    paths
        Antenna and dipole (None: both) of each; none for the whole station or array.
    kind
        One of `KINDS`.
    date, sigma
        When, and its standard deviation in microseconds.
    size, size_sigma
        Change of C as a fraction with its standard deviation; None where it is not known. That of a ramp is for a year
        from the date on, that of a season its amplitude: at the date of every year C is largest.
    tilt, curvature
        Change of ln C as the Legendre polynomials 1 and 2 over the band; None where there is none.
    own
        Sizes of the paths that changed by another amount.
    """

    station: str | None
    paths: tuple[tuple[int, str | None], ...]
    kind: str
    date: Instant
    sigma: int
    size: float | None = None
    size_sigma: float | None = None
    tilt: float | None = None
    curvature: float | None = None
    own: tuple[OwnSize, ...] = ()

    def of(self, antenna: int | None, dipole: str | None) -> Change:
        """The change as a path has it: by the size of its own, if it has one."""
        own = next((one for one in self.own if (one.antenna, one.dipole) == (antenna, dipole)), None)
        return self if own is None else replace(self, own=(), **{name: getattr(own, name) for name in SIZED})

    @property
    def sigma_days(self) -> float:
        """The standard deviation of the date, days."""
        return self.sigma / DAY_US

    @property
    def antennas(self) -> list[int]:
        """The antennas that changed, each once."""
        return sorted({antenna for antenna, _ in self.paths})

    def shape(self, frequency_mhz: Floats) -> list[float] | None:
        """Change of C along frequency, a fraction; None where its size is not known."""
        if self.size is None:
            return None
        return [float(one) for one in np.expm1(spread_over_band(self.modes, frequency_mhz))]

    def dipoles_of(self, antenna: int) -> tuple[str, ...] | None:
        """The dipoles of an antenna that changed; None for both."""
        found = [dipole for one, dipole in self.paths if one == antenna]
        return None if None in found else tuple(str(one) for one in found)

    def is_same(self, other: Change) -> bool:
        """Whether two are one: of a kind, with an antenna in common, and dates that agree within their errors.

        What goes on changing is one where paths and size are, too.
        """
        if (self.station, self.kind) != (other.station, other.kind):
            return False
        if self.kind != STEP and (self.paths != other.paths or not self._has_size_of(other)):
            return False
        if not is_same_date((self.date, self.sigma), (other.date, other.sigma)):
            return False
        return bool(set(self.antennas) & set(other.antennas)) or not (self.paths or other.paths)

    @property
    def estimate(self) -> dict[str, Any]:
        """The date and size with their errors, and the shape."""
        return {name: getattr(self, name) for name in (*DATED, *SIZED)}

    def is_away_from(self, other: Change) -> bool:
        """Whether another estimate of it differs: a size by more than its error, a date by a day and two errors."""
        if abs(self.date - other.date) > max(DAY_US, MOVED_DATE * other.sigma):
            return True
        if self.size is None or other.size is None:
            return self.size is not other.size
        paths = [(None, None), *self.paths]
        return any(
            abs(one - then) > (other.of(*path).size_sigma or 0.0)
            for path in paths
            for one, then in zip(self.of(*path).modes, other.of(*path).modes, strict=True)
        )

    def has_all_of(self, other: Change) -> bool:
        """Whether all antennas of another one are among its own."""
        return set(other.antennas) <= set(self.antennas)

    def as_found(self, other: Change, gone: Collection[tuple[int, str | None]] = ()) -> Change:
        """Take date and size of another report of it, and the dipoles of its antennas which that adds, without some."""
        more = [
            path for path in other.paths if path[0] in self.antennas and {path, (path[0], None)}.isdisjoint(self.paths)
        ]
        return replace(other, paths=(*(path for path in self.paths if path not in gone), *more))

    def as_told(self, other: Change) -> Change:
        """Take what a person tells of it: a date beyond a day of its own, and all else where a size is given."""
        told = self if other.size is None else self.as_found(other)
        dated = self if abs(self.date - other.date) <= DAY_US else other
        return replace(told, date=dated.date, sigma=dated.sigma)

    @property
    def power(self) -> float | None:
        """The power after it over that before; None where its size is not known, or nothing is left to be scaled."""
        power = None if self.size is None else (1.0 + self.size) ** -2.0  # C^2 is proportional to 1 / power
        return None if power is None or abs(math.log(power)) > LARGEST_TAKEN_OUT else power

    @property
    def shape_of_power(self) -> tuple[float, float]:
        """The Legendre coefficients 1 and 2 of ln of that power over the band."""
        return -2.0 * (self.tilt or 0.0), -2.0 * (self.curvature or 0.0)

    @property
    def modes(self) -> tuple[float, float, float]:
        """The change of ln C: in the mean over the band, and as the Legendre polynomials 1 and 2."""
        return math.log1p(self.size or 0.0), self.tilt or 0.0, self.curvature or 0.0

    def _has_size_of(self, other: Change) -> bool:
        reach = SAME_DATE * math.hypot(self.size_sigma or 0.0, other.size_sigma or 0.0)
        return abs((self.size or 0.0) - (other.size or 0.0)) <= reach


LARGEST_TAKEN_OUT = math.log(2.0)
"""Ln of the power beyond which a change is not taken out of a mean: what is dead, or 3 dB lower, adds its noise."""


@dataclass(frozen=True)
class Cut:
    """A date at which the windows of an antenna are cut, both dipoles alike; of all of a station where it is None.

    `dipoles` are those that changed, None for both, and `power` is theirs after it over that before; None where the
    size of the change is not known. `shape` are the Legendre coefficients 1 and 2 of ln of it over the band. With
    `slow` it is no step: C follows it, and no window is cut. `sigma` is the error of the date, and `known` the instant
    since which it is in force. `own` has a dipole that changed by another amount, with its power and shape.
    """

    station: str
    antenna: int | None
    date: Instant
    dipoles: tuple[str, ...] | None = None
    power: float | None = None
    shape: tuple[float, float] = (0.0, 0.0)
    slow: SlowChange | None = None
    sigma: int = 0
    known: Instant = 0
    own: tuple[tuple[str, float, tuple[float, float]], ...] = ()

    def begins_before(self, until: Instant) -> bool:
        """Whether it shows before an instant: a season has no beginning."""
        return self.date < until or (self.slow is not None and self.slow.is_season)

    def step_of(self, dipole: str | None) -> tuple[float | None, tuple[float, float]]:
        """The power of a dipole after it over that before, and its shape."""
        return next(((power, shape) for one, power, shape in self.own if one == dipole), (self.power, self.shape))

    def log_power(self, time_unix: Floats, modes: Floats, dipole: str) -> Floats:
        """Ln of the power of a dipole over what it was before, at s UTC, shape (time, freq).

        `modes` are the Legendre polynomials 1 and 2 over the band, shape (2, freq).
        """
        if self.slow is not None:
            return -2.0 * np.outer(self.slow.follow(time_unix), self.slow.size + self.slow.shape @ modes)
        power, shape = self.step_of(dipole)
        return np.outer(time_unix >= self.date / SECOND_US, np.log(power or 1.0) + shape @ modes)

    @property
    def warning(self) -> str:
        """A warning about C while one version answers on both sides of a cut."""
        who, day = name_path(self.station, self.antenna), format_instant(self.date)[:10]
        return f"{who} changed on {day} ({NOT_REFITTED}): C in effect is the mean over the change"


@dataclass(frozen=True)
class Evidence:
    """A source of a change: its kind, the report that it refers to, and the first and last time at which it held.

    With the estimate that the change has since then; None for what it keeps of the one that it had.
    """

    source: str
    ref: str
    significance: float | None
    made: Instant
    ended: Instant | None = None
    date: Instant | None = None
    sigma: int | None = None
    size: float | None = None
    size_sigma: float | None = None
    tilt: float | None = None
    curvature: float | None = None


@dataclass(frozen=True)
class Decision:
    """A person's decision on a change: in force, or dismissed."""

    decision: str
    at: Instant
    by: str
    reason: str


@dataclass(frozen=True)
class KeptChange:
    """A change on record with its evidence and the decisions about it, oldest first.

    `is_refitted`: no version that was fitted over a date at which it cuts windows answers on both sides of it.
    `doubts`: what spectra, or others on record, say against it (`service.usecases.doubts`).
    """

    number: int
    change: Change
    made: Instant
    evidence: tuple[Evidence, ...]
    decisions: tuple[Decision, ...] = ()
    is_refitted: bool = True
    doubts: tuple[str, ...] = ()

    @property
    def said(self) -> Decision | None:
        """The last decision."""
        return self.decisions[-1] if self.decisions else None

    @property
    def is_spoken_of(self) -> bool:
        """Whether a person says so."""
        return any(one.source == PERSON and one.ended is None for one in self.evidence)

    @property
    def is_on_record(self) -> bool:
        """Whether the record of the instrument says so."""
        return any(one.source == RECORD and one.ended is None for one in self.evidence)

    @property
    def bounds_epoch(self) -> bool:
        """Whether an epoch ends there and another begins."""
        return bool(self.cuts) or (self.stands and self.is_on_record)

    @property
    def ended(self) -> Instant | None:
        """When the last source no longer said so; None while one does."""
        ends = [one.ended for one in self.evidence]
        return None if None in ends else max((end for end in ends if end is not None), default=self.made)

    @property
    def decision(self) -> str:
        """Proposed, in force or dismissed: the last decision, or what follows from who says so now, or said so last."""
        if self.said is not None:
            return self.said.decision
        say_so = [one for one in self.evidence if one.ended is None] or self.evidence
        return PROPOSED if all(one.source == INVESTIGATION for one in say_so) else IN_FORCE

    @property
    def state(self) -> str:
        """Say whether it has ended, waits for a refit, or what was decided, or is on record where nobody decided."""
        decision = "on record" if self.is_on_record and self.said is None else self.decision.replace("_", " ")
        decided = decision if self.is_refitted else NOT_REFITTED
        return decided if self.ended is None else "ended"

    @property
    def stands(self) -> bool:
        """Whether it is in force, and somebody still says so."""
        return self.decision == IN_FORCE and self.ended is None

    @property
    def cuts(self) -> list[Cut]:
        """Where windows are cut because of it."""
        return self.steps if self.change.sigma <= LARGEST_DATE_ERROR_US else []

    @property
    def steps(self) -> list[Cut]:
        """The step of each antenna, while it is in force, however badly its date is known; none that is on record."""
        return self._list_steps() if self.stands else []

    @property
    def dismissed_steps(self) -> list[Cut]:
        """The same of one that a person dismissed: a window that is whole again holds it."""
        return self._list_steps() if self.decision == DISMISSED else []

    def _list_steps(self) -> list[Cut]:
        one = self.change
        if one.kind != STEP or self.is_on_record:
            return []
        cuts = self._of_each(power=one.power, shape=one.shape_of_power)
        for k, cut in enumerate(cuts):
            own = [(by.dipole, one.of(by.antenna, by.dipole)) for by in one.own if by.antenna == cut.antenna]
            sized = tuple((letter, of.power, of.shape_of_power) for letter, of in own if of.power is not None)
            # what of an antenna has no power left is no part of a mean, and no more is its other dipole
            cuts[k] = replace(cut, own=sized) if len(sized) == len(own) else replace(cut, power=None)
        return cuts

    @property
    def rank(self) -> tuple[Instant, int]:
        """The last of a kind counts: the one that a person spoke of last, else the newest."""
        return 0 if self.said is None else self.said.at, self.number

    @property
    def follows(self) -> list[Cut]:
        """The ramps and seasons of antennas, or of a station, which are taken out of the means that these are in."""
        return [] if self.slow is None else self._of_each(slow=self.slow)

    def _of_each(self, **what: Any) -> list[Cut]:
        one = self.change
        if one.station is None:
            return []
        known = self.made if self.said is None else self.said.at
        cut = Cut(one.station, None, one.date, **what, sigma=one.sigma, known=known)
        who = [replace(cut, antenna=number, dipoles=one.dipoles_of(number)) for number in one.antennas]
        return who if one.paths else [cut]

    @property
    def slow(self) -> SlowChange | None:
        """The ramp or season that C follows, while it is in force; None of another change."""
        one = self.change
        if not self.stands or one.kind not in (RAMP, SEASON) or one.size is None:
            return None
        date, late = one.date / SECOND_US, one.sigma / SECOND_US
        shape = (one.tilt or 0.0, one.curvature or 0.0)
        return SlowChange(one.kind == SEASON, date, late, math.log1p(one.size), one.size_sigma or 0.0, shape)

    def seen_at(self, as_of: Instant) -> KeptChange:
        """The same with the evidence and the estimate that there were at an instant."""
        known = [
            replace(one, ended=None if one.ended is None or one.ended > as_of else one.ended)
            for one in self.evidence
            if one.made <= as_of
        ]
        said: dict[str, Any] = {}
        for one in known:
            given = () if one.date is None else DATED if one.size is None and said else (*DATED, *SIZED)
            said |= {name: getattr(one, name) for name in given}
        seen = replace(self.change, **said)
        seen = seen if seen.size == self.change.size else replace(seen, own=())  # of what was estimated last
        return replace(self, change=seen, evidence=tuple(known))


def concerns(kept: KeptChange, antenna: int | None, dipole: str | None) -> bool:
    """Whether a change is of an antenna and dipole, where these are asked for."""
    of = kept.change.paths
    is_its = [antenna in (None, own) and (dipole is None or letter in (None, dipole)) for own, letter in of]
    return not of or any(is_its)


@dataclass(frozen=True)
class Epoch:
    """A time [start, end) in which nothing changed that is in force or on record.

    `because` and `ended_by` are the changes there; None where it is open, or a record of the instrument begins or ends
    of which no change tells yet.
    `start_sigma` and `end_sigma` are the errors of their dates.
    """

    start: Instant | None
    end: Instant | None
    because: int | None
    ended_by: int | None
    start_sigma: int = 0
    end_sigma: int = 0


def split_epochs(scope: Scope, changes: Iterable[KeptChange], records: Iterable[AntennaRecord] = ()) -> list[Epoch]:
    """The times between changes of a path that are in force, or that are of a whole station.

    Parameters
    ----------
    changes
        Those of the scope itself; others are not left out.
    records
        Those of a path in the instrument, which count before they are told as changes.
    """
    ends = (end for one in records for end in (one.since, one.until) if end is not None)
    dates: dict[Instant, tuple[int | None, int]] = {round(end * SECOND_US): (None, 0) for end in ends}
    dates |= {
        one.change.date: (one.number, one.change.sigma)
        for one in changes
        if one.bounds_epoch and (scope.antenna is not None or not one.change.paths)
    }
    edges = [(None, (None, 0)), *sorted(dates.items()), (None, (None, 0))]
    return [
        Epoch(start, end, because, ended_by, start_sigma, end_sigma)
        for (start, (because, start_sigma)), (end, (ended_by, end_sigma)) in pairwise(edges)
    ]


def _sort_cuts(cuts: Iterable[Cut]) -> list[Cut]:
    return sorted(cuts, key=lambda cut: (cut.station, -1 if cut.antenna is None else cut.antenna, cut.date))


class ChangeStore(Store):
    """Changes that are and were on record."""

    def kept(self, station: str | None = None, as_of: Instant | None = None) -> list[KeptChange]:
        """Changes of all stations, or of one and of the array, in order of station and date; as known at an instant."""
        is_near = true() if station is None else or_(change.c.station == station, change.c.station.is_(None))
        statement = select(change).where(is_near)
        return self._read(statement.order_by(change.c.station, change.c.date_us, change.c.id), as_of)

    def get(self, number: int) -> KeptChange:
        """Get one change; `NotFoundError` for an unknown number."""
        found = self._read(select(change).where(change.c.id == number))
        return require_one(found, f"no change {number}; GET /v1/changes lists them")

    def cuts(self, station: str | None = None, since: Instant | None = None, until: Instant | None = None) -> list[Cut]:
        """Where windows are cut, inside a window, in order of station, antenna and date."""
        found = [cut for one in self.kept(station) for cut in one.cuts]
        inside = [cut for cut in found if (since is None or cut.date > since) and (until is None or cut.date < until)]
        return _sort_cuts(inside)

    def of_fits(self, station: str | None) -> tuple[list[Cut], list[Cut]]:
        """List what changed of a station or of all, slow changes of single antennas too; and what cuts no window.

        That are the steps in force whose dates are not known well enough.
        """
        kept = self.kept(station)
        ranked = sorted(kept, key=lambda one: one.rank)
        last: dict[tuple[Any, ...], Cut] = {}
        for one in reversed(ranked):
            for cut in one.follows:
                last.setdefault((one.change.kind, cut.station, cut.antenna, cut.dipoles), cut)
        slow = reversed(last.values())  # in order of rank: where two have a path in common, the last counts
        undated = _sort_cuts(step for one in kept if not one.cuts for step in one.steps)
        return [*_sort_cuts(cut for one in kept for cut in one.cuts), *slow], undated

    def last_act(self, station: str | None, since: Instant, until: Instant) -> list[int]:
        """How many sources of changes in a window ended, and the number of the last decision: nothing where none did.

        Windows that are whole again are those of before: the pair says that they are due.
        """
        ended = select(func.count()).select_from(change_evidence).join(change)
        decided = select(func.coalesce(func.max(change_decision.c.id), 0)).select_from(change_decision).join(change)
        inside = [change.c.date_us > since, change.c.date_us < until, *equal(change, station=station, kind=STEP)]
        asked = ended.where(change_evidence.c.ended_us.is_not(None), *inside), decided.where(*inside)
        pair = self._connection.execute(select(*(one.scalar_subquery() for one in asked))).one()
        return list(pair) if any(pair) else []

    def note(self, found: Change, evidence: Evidence) -> KeptChange:
        """Write what a source says: of a change that is on record, or of a new one.

        One that is on record keeps its date and size, unless a person gives others. Antennas that were not among its
        own are a change of their own.
        """
        near = [change.c.station == found.station, change.c.kind == found.kind]
        near += [] if found.kind == STEP else [change.c.paths == json.dumps(found.paths)]
        ordered = select(change).where(*near).order_by(change.c.date_us, change.c.id)
        same = _choose([one for one in self._read(ordered) if one.change.is_same(found)], found.date)
        covered = {antenna for one in same for antenna in one.change.antennas}
        rest = tuple(path for path in found.paths if path[0] not in covered)
        numbers = [one.number for one in same]
        for one in same:
            lasting = [(by.source, by.ref) for by in one.evidence if by.ended is None]
            if evidence.source == PERSON and found.has_all_of(one.change):
                told = one.change.as_told(found)
                own = replace(found, date=told.date, sigma=told.sigma).estimate
                self.move(one.number, told, replace(evidence, **own))
            elif (evidence.source, evidence.ref) not in lasting:
                self._add_evidence(one.number, evidence)
        if rest or not same:
            part = replace(found, paths=rest)
            row = to_row(part, change, paths=_write_paths(part), made_us=evidence.made)
            made = self._connection.execute(change.insert().values(row).returning(change.c.id))
            numbers.append(int(made.scalar_one()))
            self._add_evidence(numbers[-1], replace(evidence, **found.estimate))
        return self.get(numbers[0])

    def move(self, number: int, found: Change, evidence: Evidence) -> None:
        """Write that a source gives a change another date, size or dipole from now on, in place of what it said.

        The evidence has what the source itself gives, or all of it.
        """
        self.end(number, evidence.source, evidence.made)
        own = update(change).where(change.c.id == number)
        self._connection.execute(own.values(to_row(found, change, paths=_write_paths(found))))
        self._add_evidence(number, evidence if evidence.date is not None else replace(evidence, **found.estimate))

    def _add_evidence(self, number: int, evidence: Evidence) -> None:
        self._connection.execute(change_evidence.insert().values(to_row(evidence, change_evidence, change=number)))

    def end(self, number: int, source: str, now: Instant) -> None:
        """Note that a source no longer holds."""
        own = change_evidence.c.change == number, change_evidence.c.source == source
        lasts = change_evidence.c.ended_us.is_(None)
        self._connection.execute(update(change_evidence).where(*own, lasts).values(ended_us=now))

    def decide(self, number: int, decision: Decision) -> KeptChange:
        """Write a decision about one."""
        self._connection.execute(change_decision.insert().values(to_row(decision, change_decision, change=number)))
        return self.get(number)

    def _read(self, statement: Select[Any], as_of: Instant | None = None) -> list[KeptChange]:
        rows = self._connection.execute(statement).all()
        numbers = [row.id for row in rows]
        evidence = self._of(change_evidence, Evidence, numbers)
        decisions = self._of(change_decision, Decision, numbers)
        kept = []
        for row in rows:
            paths = json.loads(row.paths)
            of = {
                "paths": tuple((antenna, dipole) for antenna, dipole, *_ in paths),
                "own": tuple(OwnSize(*one) for one in paths if len(one) > len(PATH)),
            }
            said = tuple(one for one in decisions.get(row.id, ()) if as_of is None or one.at <= as_of)
            own = tuple(evidence.get(row.id, ()))
            one = KeptChange(row.id, from_row(Change, row, **of), row.made_us, own, said)
            if as_of is None or row.made_us <= as_of:
                kept.append(one if as_of is None else one.seen_at(as_of))
        return kept

    def _of(self, table: Any, kind: type[Any], numbers: Sequence[int]) -> dict[int, list[Any]]:
        """Rows of a table about changes, by the change, in the order in which they were written."""
        found: dict[int, list[Any]] = {}
        statement = select(table).where(table.c.change.in_(numbers)).order_by(table.c.id)
        for row in self._connection.execute(statement) if numbers else ():
            found.setdefault(row.change, []).append(from_row(kind, row))
        return found


def _write_paths(found: Change) -> str:
    """The antenna and dipole of each path as JSON, and the size of its own where it has one."""
    own = {(one.antenna, one.dipole): astuple(one) for one in found.own}
    return json.dumps([own.get((antenna, str(dipole)), (antenna, dipole)) for antenna, dipole in found.paths])


def _choose(same: Sequence[KeptChange], date: Instant) -> list[KeptChange]:
    """The changes that are on record of one that was found: those that last, and of others what these do not hold."""
    chosen = [one for one in same if one.ended is None]
    for one in sorted((one for one in same if one.ended is not None), key=lambda one: abs(one.change.date - date)):
        held = {antenna for other in chosen for antenna in other.change.antennas}
        if not chosen or set(one.change.antennas) - held:
            chosen.append(one)
    return chosen
