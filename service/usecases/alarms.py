"""Alarms: what is wrong and lasts, told once; acknowledged by those who know of it.

Steps and slopes come from the watch (`service.usecases.watch`), which follows all paths when their months changed. What
a look at the database can tell is looked for every day, before the work and after it: paths that went silent or dead
while others have events, data that stopped coming, versions that misfit, named causes that move C in effect, adopted
causes that gain too little on new events, work that failed and that nothing made up for.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal.instants import DAY_US, SECOND_US, format_instant, parse_instant
from lbacal_core.causes.model import Model
from lbacal_core.curves.curves import OK
from lbacal_core.curves.validity import Instant, Promotion, Scope
from lbacal_core.drift.members import name_members
from lbacal_core.errors import BadInputError, name_path, write_count
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.screening import LASTING_EVENTS
from service.storage.alarms import (
    ACKNOWLEDGED,
    FAILED_JOB,
    KINDS,
    LEFT_OUT,
    LOST_C,
    LOST_PATH,
    MISFIT,
    NAMED_CAUSE,
    OPEN,
    RETRACTED,
    SLOPE,
    STALE_DATA,
    STEP,
    Acknowledgement,
    Alarm,
    AlarmsAsked,
    News,
)
from service.storage.changes import DISMISSED, NOT_REFITTED, KeptChange, concerns, is_same_date
from service.storage.database import Database, Stores
from service.storage.jobs import Job
from service.storage.ledger import pick_answering
from service.storage.models import Investigation
from service.storage.processes import SCHEDULER
from service.storage.spectra import Window
from service.storage.versions import Summary, Version
from service.usecases.drift import year_of
from service.usecases.retractions import find_retracted
from service.usecases.watch import MEMBERS_NAMED, UNLESS, read_changes
from service.wire.bodies import AcknowledgementBody

if TYPE_CHECKING:
    from service.usecases.changes import Changes
    from service.usecases.models import Models

# Named causes that move C: what an investigation found, while the calibrations in effect were made without it.
#
# The gate compares a version with the one before and with the chain test. What moves C of every year alike passes both:
# a clock an hour ahead by 1 to 3 %. The investigation of a station's year names it, and the alarm says that C in effect
# is off by it, until the cause is adopted or what is wrong is put right.


@dataclass(frozen=True)
class _Named:
    """A finding that moves C by `moved`, whose statistical error is `error`, both fractions; and who found it."""

    made: Investigation
    number: int
    finding: Mapping[str, Any]
    moved: float
    error: float


def find_named(stores: Stores) -> Iterator[News]:
    """Find the causes that move C in effect by more than its statistical error; years of one cause are one alarm."""
    found: dict[tuple[str, str, str], list[_Named]] = {}
    for made in stores.investigations.newest_with_findings():
        model = stores.models.during(made.station, made.since, made.until)
        is_of_model = made.inputs.get("model") == (None if model.is_plain else model.id)
        if not is_of_model or made.until != year_of(made.since)[1]:
            continue
        for number, finding in enumerate(made.report["findings"]):
            moved, error = finding["calibration_change"]["median_fraction"], _find_error(stores, made, finding)
            if error is not None and moved > error and _can_be_adopted(model, made, number):
                key = made.station, str(finding["cause"]), str(finding["evidence"]["target"])
                found.setdefault(key, []).append(_Named(made, number, finding, moved, error))
    for (station, cause, target), years in found.items():
        yield _tell(station, f"{cause} {target}", sorted(years, key=lambda one: one.made.since))


def _find_error(stores: Stores, made: Investigation, finding: Mapping[str, Any]) -> float | None:
    """The statistical error of C in effect for what a finding is about, without the cause; None where nothing is."""
    antennas, dipoles = finding["where"]["antennas"], finding["where"]["dipoles"]
    scope = Scope(made.station, antennas[0], dipoles[0]) if len(antennas) == 1 else Scope(made.station)
    answering = pick_answering(stores.ledger.answers([scope], (made.since + made.until) // 2, None)).get(scope)
    return None if answering is None else _typical_error(stores.versions.get(str(answering.calibration)))


def _typical_error(version: Version) -> float | None:
    """The largest error of its curves in the median of their good channels, as a fraction of C."""
    errors = [
        float(np.median((curve.c_sigma_stat / curve.c)[curve.flags == OK]))
        for curve in version.curves
        if curve.c is not None and curve.c_sigma_stat is not None and np.any(curve.flags == OK)
    ]
    return max(errors, default=None)


def _can_be_adopted(model: Model, made: Investigation, number: int) -> bool:
    """Whether the model can have it: what is static is in C already, what follows the date is a change."""
    try:
        model.adopt(made.report, number, made.since // SECOND_US).require_one_c("finding")
    except BadInputError:
        return False
    return True


def _tell(station: str, subject: str, years: Sequence[_Named]) -> News:
    """The alarm of a cause, in the words of the year in which it moves C by most of its errors."""
    worst = max(years, key=lambda one: one.moved / one.error)
    named = ", ".join(format_instant(one.made.since)[:4] for one in years)
    sentence = (
        f"{station} in {named}: {worst.finding['sentence']} C in effect was made without it and is off by "
        f"{worst.moved:.1%}, {worst.moved / worst.error:.1f} of its statistical errors: adopt it (investigation "
        f"{worst.made.id[:10]}, finding {worst.number}), or put right what is wrong"
    )
    content = {
        "cause": worst.finding["cause"],
        "years": [
            {
                "since": format_instant(one.made.since), "investigation": one.made.id, "finding": one.number,
                "fraction": one.moved, "statistical_error": one.error,
            }
            for one in years
        ],
    }  # fmt: skip
    return News(NAMED_CAUSE, Scope(station), subject, sentence, content, years[0].made.since)


LOOKED_FOR = frozenset(KINDS) - {STEP, SLOPE}
FAILURES_SINCE_US = 30 * DAY_US
FAILURES_READ = 200
NAMES = {
    "step": ("step", "steps"), "slope": ("slope", "slopes"), "lost_path": ("lost path", "lost paths"),
    "left_out": ("path whose newest spectra are left out", "paths whose newest spectra are left out"),
    "lost_c": ("window without C", "windows without C"),
    "retracted": ("window whose events were flagged", "windows whose events were flagged"),
    "stale_data": ("stale data", "stale data"), "misfit": ("misfit", "misfits"),
    "named_cause": ("cause named and not adopted", "causes named and not adopted"),
    "cause_stopped_paying": ("cause that stopped paying", "causes that stopped paying"),
    "failed_job": ("failed job", "failed jobs"),
}  # fmt: skip


@dataclass(frozen=True)
class AlarmCounts:
    """How many alarms last, by kind, and how many of all were raised within a day."""

    open: Mapping[str, int]
    acknowledged: Mapping[str, int]
    new: int

    @property
    def line(self) -> str:
        """All of it in one line."""
        total, known = sum(self.open.values()), sum(self.acknowledged.values())
        kinds = ", ".join(f"{count} {NAMES[kind][count > 1]}" for kind, count in self.open.items())
        told = f"{total} open ({kinds})" if total else "none open"
        return f"{told}, {known} acknowledged; {self.new} new since yesterday" if total or known else told


@dataclass(frozen=True)
class Alarms:
    """Looks for what is wrong, lists it, and takes acknowledgements."""

    database: Database
    instrument: Instrument
    clock: Callable[[], Instant]
    stale_days: float
    find_models: Callable[[], Models]
    changes: Changes

    def look(self) -> list[int]:
        """Take in what the database tells; the alarms that are new."""
        now = self.clock()
        stopped = self.find_models().stopped()
        with self.database.read() as stores:
            present = [
                *stopped,
                *self._lost(stores),
                *find_left_out(stores),
                *find_lost_c(stores),
                *self._stale(stores, now),
                *_misfits(stores),
                *find_named(stores),
                *_failures(stores, now),
            ]
        with self.database.write() as stores:
            return stores.alarms.settle(LOOKED_FOR, present, now)

    def newest(self, asked: AlarmsAsked) -> list[Alarm]:
        """List alarms, newest first."""
        with self.database.read() as stores:
            found = stores.alarms.newest(asked, self.clock())
        kept = self.changes.list_all(asked.station)
        return [_with_state(one, kept) for one in found]

    def acknowledge(self, number: int, body: AcknowledgementBody, by: str) -> Alarm:
        """Record that somebody knows of it, until an instant or for good."""
        now = self.clock()
        until = None if body.until is None else parse_instant("body.until", body.until)
        if until is not None and until <= now:
            raise BadInputError("body.until", "an instant in the future", str(body.until))
        with self.database.write() as stores:
            return stores.alarms.acknowledge(number, Acknowledgement(by, now, body.reason, until))

    def _lost(self, stores: Stores) -> Iterator[News]:
        """Paths on record without a usable event while that with the newest had many; those lost together are one."""
        from lbacal_core.drift.report import SILENT_EVENTS

        newest = stores.spectra.newest_by_path()
        dead = {path: at for path, at in _silent(stores).items() if at < newest.get(path, at)}
        newest |= dead
        if not newest:
            return
        last = max(newest.values())
        witness = next(path for path, instant in newest.items() if instant == last)
        lost: dict[tuple[str, int], list[Scope]] = {}
        on_record = {(one.station, one.antenna) for one in self.instrument.antennas if one.covers(last / SECOND_US)}
        for path, instant in newest.items():
            if instant < last and path.parts[:2] in on_record:
                lost.setdefault((str(path.station), instant), []).append(path)
        for (station, instant), paths in lost.items():
            missed = stores.spectra.count(Window(instant + 1, last + 1, witness))
            if missed < SILENT_EVENTS:
                continue
            scope = paths[0] if len(paths) == 1 else Scope(station)
            who = _name_paths(station, paths)
            day = format_instant(instant)[:10]
            what = "no spectrum that sees the sky" if paths[0] in dead else "no spectrum"
            sentence = f"{who}: {what} since {day}, while {name_path(*witness.parts)} has {missed} more events"
            content = {"paths": [path.key for path in paths], "events_missed": missed}
            yield News(LOST_PATH, scope, "", sentence, content, instant)

    def _stale(self, stores: Stores, now: Instant) -> Iterator[News]:
        newest = stores.spectra.newest_until(now)
        if newest is None or self.stale_days == 0.0 or now - newest < self.stale_days * DAY_US:
            return
        sentence = f"the newest event is of {format_instant(newest)[:10]}, more than {self.stale_days:g} days ago"
        yield News(STALE_DATA, Scope(), "", sentence, {"newest_event": format_instant(newest)}, newest)


def _with_state(alarm: Alarm, kept: Sequence[KeptChange]) -> Alarm:
    """An alarm of a step that says whether a person dismissed the change, and whether its windows are refitted."""
    if not kept or alarm.news.kind != STEP or alarm.ended is not None:
        return alarm
    found = read_changes(alarm.news.content)
    own = [one for one in kept if one.ended is None and any(of.is_same(one.change) for of in found)]
    told, is_dismissed = alarm.news.sentence, {one.decision == DISMISSED for one in own}
    if told.endswith(UNLESS) and len(is_dismissed) == 1:
        so_far = told.removesuffix(UNLESS)
        told = f"{so_far.rpartition('; ')[0]}; a person dismissed the change" if True in is_dismissed else so_far
    told += "" if all(one.is_refitted for one in own) else f" ({NOT_REFITTED})"
    return replace(alarm, news=replace(alarm.news, sentence=told))


def find_left_out(stores: Stores) -> Iterator[News]:
    """Find the paths whose newest spectra are all left out of fits, where no change in force explains that.

    Those of a station since one event are one alarm.
    """
    kept = [one for one in stores.changes.kept() if one.stands and one.change.kind == STEP]
    found: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for one in (stores.drift.report() or {}).get("left_out", []):  # reports of before had none
        since = round(one["last_unix"] * SECOND_US)
        of_station = [other for other in kept if other.change.station in (None, one["station"])]
        own = [other.change for other in of_station if concerns(other, one["antenna"], one["dipole"])]
        if not any(of.date > since or is_same_date((of.date, of.sigma), (since, 0)) for of in own):
            found.setdefault((one["station"], since), []).append(one)
    for (station, since), paths in found.items():
        scopes = [Scope(station, one["antenna"], one["dipole"]) for one in paths]
        spectra = max(one["spectra"] for one in paths)
        who = f"{station} ({name_members(paths, MEMBERS_NAMED)})" if len(paths) > 1 else name_path(*scopes[0].parts)
        sentence = (
            f"{who}: all {spectra} spectra since {format_instant(since)[:10]} are left out of fits as anomalous, and C "
            "in effect is that of before, flagged uncertain: enter the change if the gain is another (lbacal changes "
            f"enter), else look at the receiver; {LASTING_EVENTS} in a row count by themselves"
        )
        content = {"paths": [path.key for path in scopes], "spectra": spectra}
        yield News(LEFT_OUT, scopes[0] if len(scopes) == 1 else Scope(station), "", sentence, content, since)


def find_lost_c(stores: Stores) -> Iterator[News]:
    """Find windows without C of paths that had it before or there, and versions in effect that were retracted.

    Their versions wait for a person, or due work withdrew the last one.
    """
    standing = stores.ledger.all_standing()
    told = [
        (one.scope, (one.valid_from, one.valid_to), one.reason, True)
        for one in standing
        if one.calibration is None and one.by == SCHEDULER and one.valid_to is not None
    ]
    waiting = [one for one in stores.versions.waiting() if one.is_to_decide]
    told += [(one.scope, (one.since, one.until), one.sentence, False) for one in waiting]
    lost: dict[tuple[str, Instant, Instant], dict[Scope, str]] = {}
    for scope, window, why, had_c in told:
        middle, wider = sum(window) // 2, scope.widening
        if scope.antenna is None or pick_answering(stores.ledger.answers([scope], middle, None)):
            continue
        if had_c or stores.ledger.neighbours({scope: wider}, middle, None)[scope][0] is not None:
            lost.setdefault((str(scope.station), *window), {}).setdefault(scope, why)
    for (station, since, until), paths in lost.items():
        who, when, first = _name_paths(station, paths), _name_window(since, until), next(iter(paths))
        sentence = f"{who}, {when}: no C is in effect; {name_path(*first.parts)}: {paths[first]}"
        yield News(LOST_C, Scope(station), when, sentence, {"paths": [path.key for path in paths]}, since)
    yield from _find_retracted(stores, standing)


def _find_retracted(stores: Stores, standing: Sequence[Promotion]) -> Iterator[News]:
    versions = stores.versions.summaries({one.calibration for one in standing if one.calibration is not None})
    why = find_retracted(stores, versions)
    own = (one for one in standing if one.calibration in why)
    places = {(one.scope, (one.valid_from + (one.valid_to or one.valid_from)) // 2) for one in own}
    deciding = {one.calibration for one in stores.ledger.decisive_at(places).values()}
    found: dict[tuple[str | None, Instant, Instant], dict[str, str]] = {}
    for one in versions:
        if one.id in why and one.id in deciding:
            found.setdefault((one.scope.station, one.since, one.until), {})[one.id] = why[one.id]
    for (station, since, until), of_window in found.items():
        window, (name, first) = _name_window(since, until), next(iter(of_window.items()))
        sentence = (
            f"{station or 'the array'}, {window}: events of {write_count(len(of_window), 'version')} in effect were "
            f"flagged since, and C is uncertain ({name[:12]}: {first}): promote others, or withdraw what there is"
        )
        yield News(RETRACTED, Scope(station), window, sentence, {"versions": of_window})


def _name_paths(station: str, paths: Collection[Scope]) -> str:
    return f"{len(paths)} paths of {station}" if len(paths) > 1 else name_path(*next(iter(paths)).parts)


def _name_window(since: Instant, until: Instant) -> str:
    return f"{format_instant(since)[:10]} to {format_instant(until)[:10]}"


def _silent(stores: Stores) -> dict[Scope, Instant]:
    """When the paths that the watch found silent were measured last."""
    silent = (stores.drift.report() or {}).get("silent", [])  # reports of before had none
    return {Scope(one["station"], one["antenna"], one["dipole"]): round(one["last_unix"] * SECOND_US) for one in silent}


def count_alarms(stores: Stores, now: Instant) -> AlarmCounts:
    """Count the alarms."""
    is_open, is_known = (stores.alarms.count(now, state) for state in (OPEN, ACKNOWLEDGED))
    return AlarmCounts(is_open, is_known, stores.alarms.count_raised(now - DAY_US))


def _misfits(stores: Stores) -> Iterator[News]:
    """Windows of a station, or of the array, whose newest versions misfit."""
    found = defaultdict[tuple[str | None, str, Instant, Instant], list[Summary]](list)
    for one in stores.versions.misfits():
        found[one.scope.station, one.scope.level, one.since, one.until].append(one)
    for (station, level, since, until), own in found.items():
        window = _name_window(since, until)
        who = _name_paths(str(station), [one.scope for one in own]) if level == "antenna" else station or "the array"
        sentence = f"{who}, {window}: the chain does not describe the spectra within noise and priors (misfit)"
        content = {"versions": [one.id for one in own], "since": format_instant(since), "until": format_instant(until)}
        yield News(MISFIT, Scope(station), f"{level} {window}", sentence, content)


def _failures(stores: Stores, now: Instant) -> Iterator[News]:
    failed: dict[str, News] = {}
    for failure in stores.jobs.failures(now - FAILURES_SINCE_US, FAILURES_READ):
        if failure.tries is None:  # whoever asked for it is told by the job
            continue
        news = describe_failed(failure.job, "; ".join(failure.job.errors))
        failed.setdefault(news.subject, news)  # the newest try of a work is listed first
    yield from failed.values()


def describe_failed(job: Job, error: str) -> News:
    """The news that a job failed; another try of the same work is the same problem."""
    work = {name: value for name, value in job.request.items() if name in ("scope", "station", "since", "until")}
    named = " ".join(str(work[name]) for name in ("scope", "station") if work.get(name))
    subject = " ".join([job.kind, *(f"{name}={value}" for name, value in sorted(work.items()))])
    sentence = f"{job.kind} {named}".strip() + f" failed: {error}"
    return News(FAILED_JOB, Scope(), subject, sentence, {"job": job.number, "kind": job.kind, "request": work})
