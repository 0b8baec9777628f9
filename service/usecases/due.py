"""What is due: every day, whatever the stored spectra call for and nobody has done.

The rule. For every calendar year (UTC) that holds usable spectra there is one refit for the array, and for every
station with spectra in it one of scope station and one of scope antenna, and after all refits an investigation. It is
due when its window got new spectra or a flag was set or cleared in it, when covariates of its events became known (for
refits only where an adopted cause reads any), when the watch found that an antenna changed in it, or a person lifted
that cut, or when what was made is too old: made with another instrument, sky power or model version, by another policy
of the search, before the adoption or withdrawal of a cause that acts in the window, or while the windows beside it,
which are fitted with it, were in another state.
Work is named by exactly these, and done under the name of what it read. It is due until a part of that name is *done*:
two schedulers, a restart or a missed day change nothing, and work that failed or was cancelled is tried again, after
ten minutes and then after ever longer pauses, because what is due follows from what is stored and not from when anybody
looked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.causes.model import Model
from lbacal_core.curves.validity import Instant, Promotion, Scope
from lbacal_core.errors import name_path
from lbacal_core.provenance import canonical_json, hash_content
from lbacal_core.simulation.simulation import Simulation
from service.storage.database import Database, Stores
from service.storage.jobs import Order, Part
from service.storage.models import ModelChange
from service.storage.processes import SCHEDULER
from service.storage.versions import OF_SIMULATION
from service.usecases.drift import find_years, year_of
from service.usecases.drift_measurement import KIND as DRIFT
from service.usecases.drift_measurement import find_references
from service.usecases.fits import FitOf, Wanted, read_fits
from service.usecases.intake import judge_far
from service.usecases.investigations import KIND as INVESTIGATION
from service.usecases.investigations import Investigations
from service.usecases.orders import Inputs, name_inputs
from service.usecases.refits import KIND as REFIT
from service.usecases.refits import describe_part
from service.usecases.retractions import withdraw_retracted
from service.usecases.watch import KIND as WATCH
from service.usecases.watch import Watch

FORM = "sums"
"""What drift keeps: a year that was measured when other numbers were kept is measured again."""
ALWAYS = {"since": -np.inf, "until": np.inf}
FOREVER = 1 << 62


@dataclass(frozen=True)
class DueWork:
    """Finds and enqueues due work."""

    database: Database
    simulation: Simulation
    clock: Callable[[], Instant]
    investigations: Investigations | None
    """None where nobody wants them by schedule."""
    watch: Watch

    def enqueue(self) -> list[int]:
        """Enqueue everything that is due, and return the new jobs; spectra whose level lasts take part from now on.

        Where no usable spectrum is left, what they gave ends.
        Work that nobody has begun and that was enqueued for another instrument, sky power or model version is given up,
        and what failed and is no longer called for is no failure.
        """
        with self.database.write() as stores:
            stores.jobs.drop_outdated(self._inputs.text, self.clock())
            judge_far(stores)
            stores.ledger.append(_end_empty(stores), self.clock)
        with self.database.read() as stores:
            orders = [*self._refits(stores), *self._drift(stores)]
            called = {one.due_name for one in orders}
            orders += self._investigations(stores)
        with self.database.write() as stores:
            stores.jobs.end_failures((REFIT, DRIFT), called)
        return self._add(orders) or self.enqueue_watch()

    def enqueue_model(self, stores: Stores, change: ModelChange, *, promote: bool) -> list[int]:
        """Enqueue the refits that a change of a station's model calls for, within the transaction that writes it."""
        found = []
        for order in self._refits(stores, change):
            if order.request["station"] in (None, change.station):
                part = {**order.request, "promote": promote}
                found.append(replace(order, request=part, parts=[part], by=change.by, reason=change.reason))
        return self._add(found)

    def has_failed_lately(self) -> bool:
        """Whether due work failed within a day or two: then it is worth looking again before the daily run."""
        with self.database.read() as stores:
            failures = stores.jobs.failures(self.clock() - 2 * DAY_US, 1000)
        return any(one.tries and one.tries.again is not None and one.tries.again <= self.clock() for one in failures)

    def enqueue_next(self, part: Part) -> list[int]:
        """Enqueue what a part calls for that is done: drift of its versions, then the watch, then what that changes.

        What a refit or the watch leaves behind may call for refits: of other years of the same hardware, whose lines
        are fitted together, and where an antenna changed. They are looked for once no refit is open, and not of windows
        that are for the next daily run.
        """
        if part.kind == DRIFT:
            return self.enqueue_watch()
        orders = list[Order]()
        with self.database.read() as stores:
            if part.request.get("scope") == "antenna":
                orders += self._drift(stores, part.request["station"])
            if part.kind in (WATCH, REFIT) and not stores.jobs.is_open(REFIT):
                due = self._refits(stores)
                orders += [one for one in due if _is_changed(one) or stores.jobs.called_for(one) is not None]
        return self._add(orders)

    def name_now(self, stores: Stores, part: Part) -> Order | None:
        """The due work that a part does where it reads the state of now; None if that calls for none like it.

        Between the look that enqueues it and a worker decisions are taken, and taken back: named by what it was
        enqueued for, it would count as done where it read something else.
        """
        asked = part.request
        if not part.is_due:
            return None
        if part.kind == DRIFT:
            return next((one for one in self._drift(stores, asked["station"]) if one.request == asked), None)
        since, until, station = asked["since"], asked["until"], asked["station"]
        held = stores.spectra.contents(since, until, station)
        if not held:
            return None
        content = list(held.items()) if station is None else held[station]
        order = self._refit(stores, read_fits(stores, station), asked["scope"], Scope(station), since, until, content)
        return order if order.request == {**asked, "promote": True} else None

    def enqueue_watch(self) -> list[int]:
        """Enqueue the watch over all stations, once their measured events are others and none waits to be measured.

        Returns the new job, or nothing. The events may be again what they were: the name of the job holds the report
        that it replaces, too.
        """
        with self.database.read() as stores:
            inputs, last = self.watch.name_inputs(stores), stores.drift.report_made()
            if inputs is None or (last is not None and inputs == last[0]) or stores.jobs.is_open(DRIFT):
                return []
        return self._add([self._order(WATCH, {}, {"drift": inputs, "report": last})])

    def _add(self, orders: list[Order]) -> list[int]:
        """Enqueue what is due of these; windows that only read what other windows lend wait until that is made."""
        if not orders:
            return []
        with self.database.write() as stores:
            due = [one for one in orders if stores.jobs.is_due(one, self.clock())]
            for order in due:
                if "model" in order.request:
                    part = order.request
                    stores.models.put(stores.models.during(part["station"], part["since"], part["until"]))
            first = [one for one in due if not _reads_others(stores.jobs.called_for(one), one.called_for)]
            due = first if any(one.kind == REFIT for one in first) else due
            made = [stores.jobs.add(one, self.clock(), explain_due if one.by == SCHEDULER else None) for one in due]
        return [number for number in made if number is not None]

    def _refits(self, stores: Stores, change: ModelChange | None = None) -> Iterator[Order]:
        fits_of = cache(lambda station: read_fits(stores, station))
        for since, until in find_years(stores):
            if change is not None and not change.touches(since, until):
                continue
            held = stores.spectra.contents(since, until)
            for station, content in held.items():
                for scope in ("antenna", "station"):
                    yield self._refit(stores, fits_of(station), scope, Scope(station), since, until, content)
            if held:
                yield self._refit(stores, fits_of(None), "array", Scope(), since, until, list(held.items()))

    def _refit(
        self, stores: Stores, fit_of: FitOf, scope: str, of: Scope, since: Instant, until: Instant, content: Any
    ) -> Order:
        wanted = fit_of(scope, of, since, until)
        part = describe_part(scope, of, since, until, wanted.model, promote=True)
        acts = stores.changes.last_act(of.station, since, until)
        # a window whose own changes or causes are others by now lends nothing
        names = stores.sums.names_beside(scope, of, since, until)
        beside = [[*name, *_name_state(fit_of(scope, of, *year_of(name[0])))] for name in names]
        if beside and scope != "array":  # a change between two windows parts them, wherever it lies
            cuts = [one for one in fit_of(scope, of, since, FOREVER).changed if one.slow is None]
            cuts = [one for one in cuts if scope == "antenna" or one.antenna is None]
            beside += [[one.station, one.antenna, one.date] for one in cuts]
        called_for = {
            "spectra": content,
            "model": _name_change(stores, of.station, since, until),
            "beside": beside,
            "changes": wanted.named,
            "decisions": {"cuts": acts} if acts else None,
            "covariates": _count_covariates(stores, wanted.model, of.station, since, until),
        }
        return self._order(REFIT, part, called_for)

    def _drift(self, stores: Stores, of: str | None = None) -> Iterator[Order]:
        """What is due of one station or of all."""
        held = {years: stores.spectra.contents(*years, of) for years in find_years(stores)}
        for station in stores.spectra.stations() if of is None else [of]:
            references = find_references(stores, self.simulation.instrument, station)
            adopted = stores.models.of_station(station)
            for since, until in held if references else ():
                if (content := held[since, until].get(station)) is None:
                    continue
                part = {"station": station, "since": since, "until": until}
                model = _name_change(stores, station, since, until)
                named = {"form": FORM, "spectra": content, "references": sorted(references.values()), "model": model}
                acting = adopted.during(since / SECOND_US, until / SECOND_US)
                named["covariates"] = _count_covariates(stores, acting, station, since, until)
                yield self._order(DRIFT, part, named)

    def _investigations(self, stores: Stores) -> Iterator[Order]:
        if self.investigations is not None:
            for part, (content, search, known) in self.investigations.due(stores):
                model = _name_change(stores, *(part[name] for name in ("station", "since", "until")))
                named = {"spectra": content, "search": search, "model": model, "covariates": known}
                yield self._order(INVESTIGATION, part, named)

    def _order(self, kind: str, part: dict[str, Any], called_for: dict[str, Any]) -> Order:
        own = self._inputs
        # a cable of another antenna, or of another year, calls for nothing
        since, until = (part[name] / SECOND_US if name in part else at for name, at in ALWAYS.items())
        of = since, until, part.get("station")
        # parts of a station's year come one after the other
        of_instrument = self.simulation.made.get(("instrument", *of), lambda: self.simulation.instrument.digest_of(*of))
        named = {"instrument": of_instrument, "sky_power": own.sky_power, "model_version": own.model_version}
        given = [value for value in called_for.values() if value]
        due_name = hash_content([kind, part, *given, list(named.values())])
        return Order(kind, part, [part], "", SCHEDULER, due_name, own.text, called_for | named)

    @cached_property
    def _inputs(self) -> Inputs:
        return name_inputs(self.simulation)


def _end_empty(stores: Stores) -> list[Promotion]:
    """Forget what is kept of windows of which every event is flagged, and withdraw what due work promoted there."""
    found = list[Promotion]()
    for since, until in find_years(stores):
        if not stores.spectra.last_flag(since, until):
            continue
        held = set(stores.spectra.contents(since, until))
        stations: list[str | None] = [one for one in stores.spectra.stations() if one not in held]
        for station in stations if held else [*stations, None]:
            stores.sums.forget(Scope(station), since, until)
            found += withdraw_retracted(stores, stores.spectra.scopes_of(station), since, until)
    return found


def _name_state(wanted: Wanted) -> list[Any]:
    """Name the changes and causes that a fit reads."""
    return [*wanted.named, *([] if wanted.model.is_plain else [wanted.model.id])]


def _is_changed(order: Order) -> bool:
    """Whether an antenna changed in a window, or a decision was taken about that."""
    called_for = order.called_for or {}
    return bool(called_for["changes"] or called_for["decisions"])


def _count_covariates(stores: Stores, model: Model, station: str | None, since: Instant, until: Instant) -> int | None:
    """How many covariates are known of the events of a window; None where its model reads none."""
    return stores.spectra.count_covariates(since, until, station).total() if model.covariates else None


def _name_change(stores: Stores, station: str | None, since: Instant, until: Instant) -> int | None:
    """The number of the newest change of a model that touches a window: with each the window is due again."""
    change = stores.models.last_change(station, since, until)
    return None if change is None else change.number


# Why work is due: what of its inputs is another than when the same work was due before.

CALLED_FOR = {
    **OF_SIMULATION, "decisions": "a decision about a change", "beside": "spectra of other years",
    "model": "a cause adopted or withdrawn", "form": "other numbers are kept",
    "covariates": "other covariates are read",
    "references": "another reference", "search": "another policy of the search", "drift": "drift measured anew",
}  # fmt: skip
CHANGES_NAMED = 3


def _reads_others(before: Mapping[str, Any] | None, now: Mapping[str, Any] | None) -> bool:
    """Whether nothing of due work changed but what other windows lend."""
    return before is not None and explain_due(before, json.loads(canonical_json(now))) == CALLED_FOR["beside"]


def explain_due(before: Mapping[str, Any] | None, now: Mapping[str, Any]) -> str:
    """Name the inputs of due work that changed since it was due before."""
    if before is None:
        name = "drift" if now.get("model") is None else "model"
        return CALLED_FOR[name] if name in now else "the first of this window"
    told = [*_tell_spectra(before.get("spectra"), now.get("spectra"))]
    told += _tell_changes(before.get("changes") or [], now.get("changes") or [])
    told += [words for name, words in CALLED_FOR.items() if before.get(name) != now.get(name)]
    return "; ".join(told) or "tried again"


def _tell_spectra(before: Any, now: Any) -> Iterator[str]:
    """How many spectra came; a window of the array names those of each station."""
    if before == now:
        return
    of_stations = ([pair for _, pair in one] if isinstance(one[0], list) else [one] for one in (before, now))
    (old, old_flags), (new, flags) = (np.sum(pairs, axis=0) for pairs in of_stations)
    if new != old:
        yield f"{new - old:+d} usable spectra"
    if flags != old_flags:
        yield "a quality flag set or cleared"


def _tell_changes(before: Sequence[Any], now: Sequence[Any]) -> list[str]:
    """Which antennas changed, and which changes count no more."""
    told = [
        f"{name_path(station, antenna)} changed on {format_instant(date)[:10]}"
        for station, antenna, date, *size in now
        if [station, antenna, date, *size] not in before
    ]
    more = [f"and {len(told) - CHANGES_NAMED} more changes"] if len(told) > CHANGES_NAMED else []
    gone = sum(one not in now for one in before)
    no_more = [f"{gone} change{'s count' if gone > 1 else ' counts'} no more"] if gone else []
    return [*told[:CHANGES_NAMED], *more, *no_more]
