"""What is due: every night, whatever the stored spectra call for and nobody has done.

The rule. For every calendar year (UTC) that holds usable spectra there is one refit for the array, and for every
station with spectra in it one of scope station and one of scope antenna, and after all refits an investigation. It is
due when its window got new spectra or a flag was set or cleared in it, when the watch found that an antenna changed in
it, or a person lifted that cut, or when what was made is too old: made with
another instrument, sky power or model version, by another policy of the search, or before the adoption or withdrawal of
a cause that acts in the window.
Work is named by exactly these. It is due until a part of that name is *done*: two schedulers, a restart or a night
missed change nothing, and work that failed or was cancelled is tried again, after ten minutes and then after ever
longer pauses, because what is due follows from what is stored and not from when anybody looked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lbacal.instants import DAY_US
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.provenance import hash_content
from lbacal_core.simulation.simulation import Simulation
from service.storage.database import Database, Stores
from service.storage.jobs import Order
from service.storage.models import ModelChange
from service.storage.spectra import Window
from service.usecases.drift import find_years
from service.usecases.drift_measurement import KIND as DRIFT
from service.usecases.drift_measurement import find_references
from service.usecases.fits import find_cuts
from service.usecases.investigations import KIND as INVESTIGATION
from service.usecases.investigations import Investigations
from service.usecases.orders import Inputs, name_inputs
from service.usecases.refits import KIND as REFIT
from service.usecases.refits import describe_part
from service.usecases.watch import KIND as WATCH
from service.usecases.watch import Watch
from service.usecases.windows import SECOND_US

BY = "scheduler"
FORM = "sums"
"""What drift keeps: a year that was measured when other numbers were kept is measured again."""
ALWAYS = {"since": -np.inf, "until": np.inf}


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
        """Enqueue everything that is due, and return the new jobs.

        Work that nobody has begun and that was enqueued for another instrument, sky power or model version is given up.
        """
        with self.database.write() as stores:
            stores.jobs.drop_outdated(self._inputs.text, self.clock())
        with self.database.read() as stores:
            orders = [*self._refits(stores), *self._drift(stores, stores.spectra.stations())]
            orders += self._investigations(stores)
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
        """Whether due work failed within a day or two: then it is worth looking again before the night."""
        with self.database.read() as stores:
            failures = stores.jobs.failures(self.clock() - 2 * DAY_US, 1000)
        return any(one.tries and one.tries.again is not None and one.tries.again <= self.clock() for one in failures)

    def enqueue_cut(self) -> list[int]:
        """Enqueue the refits of the years that hold a cut: the watch may have found or ended one."""
        with self.database.read() as stores:
            orders = list(self._refits(stores, with_cuts=True))
        return self._add(orders)

    def enqueue_drift(self, station: str) -> list[int]:
        """Enqueue the drift of a station, whose versions changed."""
        with self.database.read() as stores:
            orders = list(self._drift(stores, [station]))
        return self._add(orders)

    def enqueue_watch(self) -> list[int]:
        """Enqueue the watch over all stations, once their measured events are others and none waits to be measured.

        They may be again what they were: the name says which report this look replaces.
        """
        with self.database.read() as stores:
            inputs, last = self.watch.name_inputs(stores), stores.drift.report_made()
            if inputs is None or (last is not None and inputs == last[0]) or stores.jobs.is_open(DRIFT):
                return []
        return self._add([self._order(WATCH, {}, [inputs, last], "another drift was measured than the one before")])

    def _add(self, orders: list[Order]) -> list[int]:
        if not orders:
            return []
        with self.database.write() as stores:
            for order in orders:
                if "model" in order.request:
                    part = order.request
                    stores.models.put(stores.models.during(part["station"], part["since"], part["until"]))
            made = [stores.jobs.add(order, self.clock()) for order in orders]
        return [number for number in made if number is not None]

    def _refits(self, stores: Stores, change: ModelChange | None = None, *, with_cuts: bool = False) -> Iterator[Order]:
        for since, until in find_years(stores):
            if change is not None and not change.touches(since, until):
                continue
            if with_cuts and not stores.cuts.kept(None, since, until):
                continue
            filled = []
            for station in stores.spectra.stations():
                content = stores.spectra.content(Window(since, until, Scope(station)))
                if content[0] == 0:
                    continue
                filled.append((station, content))
                for scope in ("antenna", "station"):
                    yield self._refit(stores, scope, Scope(station), since, until, content)
            if filled:
                yield self._refit(stores, "array", Scope(), since, until, filled)

    def _refit(self, stores: Stores, scope: str, of: Scope, since: Instant, until: Instant, content: Any) -> Order:
        model = stores.models.during(of.station, since, until)
        part = describe_part(scope, of, since, until, model, promote=True)
        reason = "new spectra in the window, a change of an antenna found in it, or other inputs than before"
        cuts = [[[one.station, one.antenna, one.date] for one in find_cuts(stores, of.station, since, until, model)]]
        changed = stores.cuts.last_change(of.station, since, until)
        found = [content, *_name_change(stores, of.station, since, until), *(cuts if cuts[0] else [])]
        found += [{"cuts": changed}] if changed else []
        return self._order(REFIT, part, found, reason)

    def _drift(self, stores: Stores, stations: list[str]) -> Iterator[Order]:
        for station in stations:
            references = find_references(stores, self.simulation.instrument, station)
            if not references:
                continue
            for since, until in find_years(stores):
                content = stores.spectra.content(Window(since, until, Scope(station)))
                if content[0] == 0:
                    continue
                part = {"station": station, "since": since, "until": until}
                reason = "new spectra in the window, or another reference or model"
                change = _name_change(stores, station, since, until)
                yield self._order(DRIFT, part, [FORM, content, sorted(references.values()), *change], reason)

    def _investigations(self, stores: Stores) -> Iterator[Order]:
        if self.investigations is not None:
            reason = "new spectra in the window, or another policy or inputs than before"
            for part, called_for_by in self.investigations.due(stores):
                change = _name_change(stores, *(part[name] for name in ("station", "since", "until")))
                yield self._order(INVESTIGATION, part, [*called_for_by, *change], reason)

    def _order(self, kind: str, part: dict[str, Any], called_for_by: list[Any], reason: str) -> Order:
        own = self._inputs
        # a cable of another antenna, or of another year, calls for nothing
        since, until = (part[name] / SECOND_US if name in part else at for name, at in ALWAYS.items())
        of_instrument = self.simulation.instrument.digest_of(since, until, part.get("station"))
        due_name = hash_content([kind, part, *called_for_by, [of_instrument, own.sky_power, own.model_version]])
        return Order(kind, part, [part], reason, BY, due_name, own.text)

    @cached_property
    def _inputs(self) -> Inputs:
        return name_inputs(self.simulation)


def _name_change(stores: Stores, station: str | None, since: Instant, until: Instant) -> list[int]:
    """The number of the newest change of a model that touches a window: with each the window is due again."""
    change = stores.models.last_change(station, since, until)
    return [] if change is None else [change.number]
