"""A state, not a history, decides what is in effect: spectra, the last decision on each change, what people put there.

Hypothesis draws sequences of nights, late months, changes that are entered, proposed, put in force and dismissed,
promotions, rollbacks and tags, on a service whose fits are stood in for (`life_world`). Whenever nothing is due, C of
every path, station and the array, as it is in effect around every change and in every year, is held against that which
follows from spectra and changes in force alone, by formulas that share nothing with the service. At the end of a
sequence a fresh service is, too, which got the same spectra, changes and last decisions at once.

What the oracle allows, and why:

- Two fits may differ by 0.25 sigma: due work that moves C by less is no news (docs/decisions/retention.md). Nor is it
  for the windows that are fitted together with it: each may lack an event that moved its own C by less.
- What somebody promoted or rolled back may give way to the night after new spectra, or after a decision: the newest
  promotion decides (docs/decisions/in-effect.md). Where neither came it must stay, and once it gave way C is held
  against the formulas again. What somebody withdrew, or left withdrawn by a rollback, stays so whatever comes. Ids are
  compared where nobody ever promoted anything.
- The order of the fits of a year is no history: its pieces are fitted one after the other, that with the most
  spectra first, and only later ones see earlier ones (docs/decisions/years.md).
"""

from __future__ import annotations

import itertools
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from lbacal.instants import DAY_US, format_instant
from lbacal_core.curves.validity import Instant, Promotion, Scope
from service.cli.opening import configure_logs
from service.config import Settings
from service.errors import ConflictError
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.changes import (
    DISMISSED,
    DRIFT,
    IN_FORCE,
    INVESTIGATION,
    STEP,
    Change,
    Decision,
    Evidence,
    KeptChange,
)  # fmt: skip
from service.storage.database import Stores
from service.storage.migration import upgrade
from service.usecases.changes import mark_refitted
from service.usecases.fits import SMALLEST_SHIFT
from service.usecases.promotions import Plan
from service.wire.bodies import ChangeBody, DecisionBody, PromotionBody, ReasonBody, TagBody
from service.worker import Worker
from validation.life_world import (
    ANTENNAS,
    SHAPE,
    STATION,
    STEP_AT,
    YEARS,
    Month,
    Piece,
    at,
    make_instrument,
    make_simulation,
    natural,
    spectra_of,
    standing_in,
)  # fmt: skip
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row

SEQUENCES, STEPS = 25, 16
MOST_NIGHTS = 8
"""The night that finds a change, the one that refits it and those after it; a service that needs more never rests."""
BY = "somebody"
DATES = (STEP_AT, "2014-09-20", "2015-01-01", "2015-06-20", "2016-08-20", "2016-12-20")
"""Dates of changes: that which the watch finds, one at the turn of a year, one behind which little is recorded."""
SIZES = (None, -0.05)
MONTHS = tuple((year, month) for year in YEARS for month in range(1, 13))
SCOPES = [(Scope(STATION, antenna, dipole), dipole) for antenna, dipoles in ANTENNAS.items() for dipole in dipoles] + [
    (scope, dipole) for scope in (Scope(STATION), Scope()) for dipole in "XY"
]
PROBES: tuple[Instant, ...] = tuple(
    sorted(
        {at(f"{year}-{day}") for year in YEARS for day in ("02-15", "11-15")}
        | {at(date) + DAY_US * by // 2 for date in DATES for by in (-1, 1)}
    )
)
WHY = "proof"


class Clock:
    """Every reading is a microsecond later than the one before."""

    def __init__(self) -> None:
        self.now = at("2020-01-01")

    def __call__(self) -> Instant:
        """Now."""
        self.now += 1
        return self.now


@cache
def simulation() -> Any:
    return make_simulation()


_numbers = itertools.count()


@contextmanager
def sqlite_service() -> Iterator[Factory]:
    """An empty service on SQLite."""
    with tempfile.TemporaryDirectory(prefix="lbacal-states-") as folder:
        path = Path(folder) / "states.sqlite"
        shutil.copy(_template(), path)
        with closing(str(path)) as factory:
            yield factory


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """What lasts as long as the process."""
    return tempfile.TemporaryDirectory(prefix="lbacal-states-")


@cache
def _template() -> Path:
    path = Path(_folder().name) / "template.sqlite"
    with closing(str(path)) as factory:
        upgrade(factory.database)
    return path


@contextmanager
def closing(url: str) -> Iterator[Factory]:
    """The service of a database, whose fits are let pass by the gate wherever they give C."""
    free: dict[str, Any] = {
        "gate_change": 0.9,
        "gate_error": 0.9,
        "gate_coverage": 0.01,
        "nightly_investigations": False,
    }
    factory = Factory(Settings(database_url=url, lease_s=600.0, log_level="error", **free), Clock())
    factory.__dict__ |= {"instrument": make_instrument(), "simulation": simulation()}
    try:
        yield factory
    finally:
        factory.database.close()


Make = Callable[[], Any]


def rest(factory: Factory) -> int:
    """Nights until nothing is due; how many had something to do."""
    for nights in range(MOST_NIGHTS):
        jobs = look_for_due_work(factory)
        Worker(factory, "worker").run(threading.Event(), until_idle=True)
        failed = [one.errors for one in factory.database.look(lambda stores: stores.jobs.newest()) if one.errors]
        require(not failed, f"work failed: {failed}")
        if not jobs:
            return nights
    raise AssertionError(f"something is due after {MOST_NIGHTS} nights")


def require(holds: bool, told: str) -> None:
    if not holds:
        raise AssertionError(told)


@dataclass
class InEffect:
    """The state at a probe: the version that somebody, and not the daily run, put there, and in which state."""

    calibration: str | None
    state: Any


Place = tuple[Scope, Instant]


def read_in_effect(stores: Stores) -> dict[Place, Promotion | None]:
    """Read the deciding promotion of each scope at each probe."""
    asked = [(scope, when) for scope in dict.fromkeys(scope for scope, _ in SCOPES) for when in PROBES]
    said = stores.ledger.decisive_at(asked)
    return {place: said.get(place) for place in asked}


def piece_at(pieces: Sequence[Piece], when: Instant) -> Piece | None:
    """The piece of a time, if it has C."""
    return next((one for one in pieces if one.since <= when < one.until and one.ln_c is not None), None)


@dataclass
class Told:
    """The observations of a service: acts of people, and versions in effect in each state without acts."""

    observed: dict[Place, InEffect] = field(default_factory=dict)
    touched: set[Place] = field(default_factory=set)
    state: Any = None
    states: dict[Any, dict[Place, str | None]] = field(default_factory=dict)


NEVER = "no state"


def name_state(months: Sequence[Month], changes: Sequence[KeptChange]) -> Any:
    """The spectra that are there, and where windows are cut."""
    return tuple(sorted(months)), tuple(sorted(str(cut) for one in changes for cut in one.cuts))


def compare(factory: Factory, months: Sequence[Month], told: Told) -> None:
    """Hold what is in effect, where nothing is due, against what follows from spectra and changes."""
    with factory.database.read() as stores:
        changes = mark_refitted(stores, stores.changes.kept(), "XY")
        expected, now = natural(months, changes), read_in_effect(stores)
        names = {one.calibration for one in now.values() if one is not None and one.calibration}
        versions = stores.versions.get_many(names)
    state = name_state(months, changes)
    touched = {scope.antenna for scope, _ in told.touched}
    waiting = [one.number for one in changes if not one.is_refitted and touched.isdisjoint(one.change.antennas)]
    require(not waiting, f"changes {waiting} are not refitted, and nothing is due")
    before, told.state = told.states.setdefault(state, {}), state
    for place, promotion in now.items():
        scope, when = place
        name = None if promotion is None else promotion.calibration
        where = f"{scope.key} at {format_instant(when)[:16]}"
        if promotion is not None:
            require(bool(promotion.reason), f"{where}: no reason of the promotion")
        if name is not None:
            require(bool(versions[name].reason), f"{where}: no reason of the version")
        own = [(dipole, piece_at(expected[scope, dipole], when)) for one, dipole in SCOPES if one == scope]
        last = told.observed.pop(place, None)
        if last is not None:
            require(
                name == last.calibration or (last.calibration is not None and last.state != state),
                f"{where}: what somebody put there gave way to no news",
            )
            if name == last.calibration:
                told.observed[place] = InEffect(name, state)
                continue
        for dipole, one in own:
            curve = None if name is None or not versions[name].serves(dipole) else versions[name].curve_of(dipole)
            if one is None or one.ln_c is None:
                require(curve is None, f"{where}: {name and name[:8]} answers where nothing can be fitted")
                continue
            if curve is None or curve.c is None:
                raise AssertionError(f"{where}: nothing is in effect")
            found = float(np.log(curve.c[0] * SHAPE[0] ** 0.5))
            shift = (found - one.ln_c) / one.sigma
            # the version in effect may be of fewer events, whose error is larger
            require(abs(shift) < 1.05 * (SMALLEST_SHIFT + one.lag), f"{where}: {dipole} is off by {shift:+.2f} sigma")
        if place in told.touched:
            continue
        again = before.setdefault(place, name)
        require(again == name, f"{where}: {name and name[:8]}, and {again and again[:8]} when it was like this before")


class Life(RuleBasedStateMachine):
    """The life of a station."""

    open_service: Callable[[], Any] = staticmethod(sqlite_service)
    count: ClassVar[list[int]] = [0, 0, 0]
    """Sequences, comparisons and acts."""

    def __init__(self) -> None:
        super().__init__()
        self._open = type(self).open_service()
        self.factory: Factory = self._open.__enter__()
        self.months: list[Month] = []
        self.told, self.tags = Told(), dict[str, Any]()
        self.acts: list[str] = []
        self.count[0] += 1

    def teardown(self) -> None:
        """Rest, and hold a service that is made anew against the same."""
        try:
            if self.months:
                self.do("the last night", lambda: None, is_night=True)
                self._rebuild()
        finally:
            self.close()

    def close(self) -> None:
        """Leave the service."""
        self._open.__exit__(None, None, None)

    def do(self, name: str, act: Callable[[], Any], *, is_night: bool) -> None:
        """Do something, and let nights follow or not."""
        self.acts.append(name + ("; night" if is_night else ""))
        self.count[2] += 1
        try:
            act()
            if is_night:
                rest(self.factory)
                compare(self.factory, self.months, self.told)
                self.count[1] += 1
            self._check_always()
        except AssertionError as error:
            raise AssertionError("\n".join([str(error), *self.acts])) from error

    def _check_always(self) -> None:
        """What holds at any time: a dismissed change cuts nothing, and a tag answers as it did."""
        with self.factory.database.read() as stores:
            for one in stores.changes.kept():
                require(one.decision != DISMISSED or not one.cuts, f"change {one.number} is dismissed and cuts")
            for name, (as_of, then) in self.tags.items():
                require(self._answers(stores, as_of) == then, f"the tag {name} answers otherwise")

    def _answers(self, stores: Stores, as_of: Instant) -> Any:
        return [
            {scope.key: one.calibration for scope, one in stores.ledger.decisive(of, when, as_of).items()}
            for when in PROBES
            for of in [dict.fromkeys(scope for scope, _ in SCOPES)]
        ]

    def _changes(self) -> list[KeptChange]:
        return self.factory.changes.list_all()

    def _rebuild(self) -> None:
        """A fresh service with the same spectra, changes and last decisions, late months first."""
        with type(self).open_service() as fresh:
            kept = self._changes()
            add(fresh, sorted(self.months)[::-1])
            for is_found in (False, True):
                with fresh.database.write() as stores:
                    for one in kept:
                        replay(stores, one, fresh.clock(), is_found=is_found)
                rest(fresh)
            told = Told()
            try:
                compare(fresh, self.months, told)
            except AssertionError as error:
                raise AssertionError("\n".join([f"rebuilt: {error}", *self.acts])) from error

    # What happens.

    @initialize(years=st.sets(st.sampled_from(YEARS), min_size=1), lacks=st.sets(st.integers(1, 12), max_size=5))
    def begin(self, years: set[int], lacks: set[int]) -> None:
        """Begin with most months of some years."""
        months = [(year, month) for year, month in MONTHS if year in years and month not in lacks]
        self.do(f"begin {sorted(years)} without {sorted(lacks)}", lambda: self.add(months), is_night=True)

    def add(self, months: Sequence[Month]) -> None:
        """Store the spectra of some months."""
        self.months += months
        add(self.factory, months)

    @rule()
    def night(self) -> None:
        """Nights until nothing is due."""
        self.do("", lambda: None, is_night=True)

    @rule(data=st.data(), is_night=st.booleans())
    @precondition(lambda self: len(self.months) < len(MONTHS))
    def late_month(self, data: Any, is_night: bool) -> None:
        """A month arrives late."""
        month = data.draw(st.sampled_from([one for one in MONTHS if one not in self.months]))
        self.do(f"late {month}", lambda: self.add([month]), is_night=is_night)

    @rule(
        antennas=st.sets(st.sampled_from(sorted(ANTENNAS)), min_size=1, max_size=3), date=st.sampled_from(DATES),
        size=st.sampled_from(SIZES), is_night=st.booleans(),
    )  # fmt: skip
    def enter(self, antennas: set[int], date: str, size: float | None, is_night: bool) -> None:
        """Enter what is known of a change."""
        body = ChangeBody.model_validate(
            {
                "paths": [{"station": STATION, "antenna": one} for one in sorted(antennas)],
                "at": {"value": date, "sigma_days": 1.0}, "reason": WHY,
                "size": size and {"value": size, "sigma": 0.001},
            }
        )  # fmt: skip

        def act() -> None:
            self.factory.changes.enter(body, BY)
            for one in self._changes():
                same = one.change.date == at(date) and set(one.change.antennas) & antennas
                require(not same or one.decision == IN_FORCE, f"entered, and {one.change.antennas} {one.decision}")

        self.do(f"enter {sorted(antennas)} on {date} of {size}", act, is_night=is_night)

    @rule(antenna=st.sampled_from(sorted(ANTENNAS)), date=st.sampled_from(DATES), is_night=st.booleans())
    def propose(self, antenna: int, date: str, is_night: bool) -> None:
        """An investigation finds a change."""
        change = Change(STATION, ((antenna, "X"),), STEP, at(date), DAY_US, -0.05, 0.001)

        def act() -> None:
            with self.factory.database.write() as stores:
                stores.changes.note(change, Evidence(INVESTIGATION, f"{antenna}#{date}", 9.0, self.factory.clock()))

        self.do(f"propose {antenna} on {date}", act, is_night=is_night)

    @rule(data=st.data(), decision=st.sampled_from([IN_FORCE, DISMISSED]), is_night=st.booleans())
    @precondition(lambda self: self.open_changes())
    def decide(self, data: Any, decision: str, is_night: bool) -> None:
        """Decide about a change."""
        one = data.draw(st.sampled_from(self.open_changes()))
        body = DecisionBody.model_validate({"decision": decision, "reason": WHY})

        def act() -> None:
            with suppress(ConflictError):  # it is so already
                self.factory.changes.decide(one.number, body, BY)

        named = f"{one.change.antennas} on {format_instant(one.change.date)[:10]}"
        self.do(f"{decision}: {named}", act, is_night=is_night)

    def open_changes(self) -> list[KeptChange]:
        """The changes that somebody still maintains."""
        return [one for one in self._changes() if one.ended is None]

    @rule(data=st.data(), is_part=st.booleans(), is_night=st.booleans())
    def promote(self, data: Any, is_part: bool, is_night: bool) -> None:
        """Put a version into effect, for its window or half of it."""
        with self.factory.database.read() as stores:
            stored = [one for one in stores.versions.search(None, "converged", "", 1000) if one.reason]
        version = data.draw(st.sampled_from(sorted(stored, key=lambda one: (one.scope.key, one.made, one.since))))
        since, until = version.window
        until = (since + until) // 2 if is_part else until
        body = {"calibration": version.id, "valid_from": format_instant(since), "valid_to": format_instant(until)}
        plan = self.factory.promotions.plan(PromotionBody.model_validate({**body, "reason": WHY}), BY)
        told = f"promote {version.scope.key} of {[format_instant(one)[:10] for one in (since, until, version.made)]}"
        self.do(told, lambda: self._promote(plan), is_night=is_night)

    @rule(data=st.data(), end=st.sampled_from(["12-31", "06-30"]), is_night=st.booleans())
    def withdraw(self, data: Any, end: str, is_night: bool) -> None:
        """Withdraw what a scope has in a year or half of it."""
        scope, _ = data.draw(st.sampled_from(SCOPES[:-2]))
        self.take_away(scope, data.draw(st.sampled_from(YEARS)), end, is_night=is_night)

    def take_away(self, scope: Scope, year: int, end: str = "12-31", *, is_night: bool) -> None:
        """Withdraw what a scope has in a year until the end of a day."""
        body = {
            "calibration": None, "station": scope.station, "antenna": scope.antenna, "dipole": scope.dipole,
            "valid_from": f"{year}-01-01", "valid_to": format_instant(at(f"{year}-{end}") + DAY_US), "reason": WHY,
        }  # fmt: skip
        plan = self.factory.promotions.plan(PromotionBody.model_validate(body), BY)
        self.do(f"withdraw {scope.key} in {year} until {end}", lambda: self._promote(plan), is_night=is_night)

    @rule(data=st.data(), is_night=st.booleans())
    def roll_back(self, data: Any, is_night: bool) -> None:
        """Undo an act of the ledger."""
        with self.factory.database.read() as stores:
            newest = stores.ledger.newest_number()
        number = data.draw(st.integers(1, newest))
        with suppress(ConflictError):  # nothing of it is in effect any more
            plan = self.factory.promotions.plan_rollback(number, ReasonBody(reason=WHY), BY)
            self.do(f"roll back {number} of {newest}", lambda: self._promote(plan), is_night=is_night)

    def _promote(self, plan: Plan) -> None:
        self.factory.promotions.promote(plan, lambda made, _: made)
        with self.factory.database.read() as stores:
            now = read_in_effect(stores)
        for p in plan.wanted:
            for (scope, when), found in now.items():
                if scope == p.scope and p.covers(when):
                    require(found is not None and found.by == BY, f"{scope.key}: what was promoted does not answer")
                    # while something is due, the night may have news
                    state = self.told.state if self._state() == self.told.state else NEVER
                    self.told.observed[scope, when] = InEffect(found.calibration if found else None, state)
                    self.told.touched.add((scope, when))

    def _state(self) -> Any:
        return name_state(self.months, self._changes())

    @rule()
    def tag(self) -> None:
        """Freeze what is known."""
        name = f"tag-{len(self.tags)}"

        def act() -> None:
            made, _ = self.factory.tags.put(name, TagBody(reason=WHY), BY)
            with self.factory.database.read() as stores:
                self.tags[name] = made.as_of, self._answers(stores, made.as_of)

        self.do(name, act, is_night=False)


def add(factory: Factory, months: Sequence[Month]) -> None:
    """Store the spectra of some months."""
    spectra = spectra_of(months)
    with factory.database.write() as stores:
        stores.spectra.add(spectra)


def replay(stores: Stores, one: KeptChange, now: Instant, *, is_found: bool) -> None:
    """Put a change on record as it is: what the drift alone found is left to be found, and only decided about."""
    told = [by for by in one.evidence if by.source != DRIFT and by.ended is None]
    same = [kept for kept in stores.changes.kept(STATION) if kept.change.is_same(one.change)]
    if told and not is_found:
        for by in told:
            same = [stores.changes.note(one.change, by)]
    if one.said is not None and same and is_found == (not told):
        stores.changes.decide(same[0].number, Decision(one.said.decision, now, BY, WHY))


def live(number: int, sequences: int = SEQUENCES, steps: int = STEPS, open_service: Make = sqlite_service) -> Row:
    """Draw sequences by a seed, and count what they show."""
    made = {"open_service": staticmethod(open_service), "count": [0, 0, 0]}
    machine: Any = seed(number)(type("OneLife", (Life,), made))
    quiet = settings(
        max_examples=sequences, stateful_step_count=steps, database=None, deadline=None, print_blob=False,
        suppress_health_check=list(HealthCheck), phases=[Phase.generate],
    )  # fmt: skip
    configure_logs("error")
    failures = []
    with standing_in():
        try:
            run_state_machine_as_test(machine, settings=quiet)
        except AssertionError as error:
            failures.append(str(error))
    sequences, compared, acts = machine.count
    return {"sequences": sequences, "compared": compared, "acts": acts, "failures": failures}


def judge(rows: Sequence[Row]) -> list[Found]:
    failed = sum(len(row["failures"]) for row in rows)
    return [rate_of("broken", failed, sum(row["sequences"] for row in rows))]


PARTS = (Part("stand-in", live, judge, 12, headlines=("broken",)),)
