"""What is due: every night, whatever the stored spectra call for and nobody has done.

The rule. For every calendar year (UTC) that holds usable spectra there is one refit for the array, and for every
station with spectra in it one of scope station and one of scope antenna. It is due when its window got new spectra or a
flag was set or cleared in it, or when its version is too old: made with another instrument, sky power or model version.
Work is named by exactly these, and a name is enqueued once: two schedulers, a restart or a night missed change nothing,
because what is due follows from what is stored and not from when anybody looked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from lbacal_core.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, hash_content
from lbacal_core.skypower.table import SkyPower
from lbacal_core.validity import Instant, Scope
from service.storage.database import Database, Stores
from service.storage.jobs import Order
from service.storage.spectra import Window
from service.usecases.drift import KIND as DRIFT
from service.usecases.drift import find_references
from service.usecases.refits import KIND as REFIT
from service.usecases.refits import describe_part
from service.wire.instants import parse_instant

BY = "scheduler"


@dataclass(frozen=True)
class DueWork:
    """Finds and enqueues due work."""

    database: Database
    instrument: Instrument
    sky_power: Callable[[], SkyPower]
    clock: Callable[[], Instant]

    def enqueue(self) -> list[int]:
        """Enqueue everything that is due, and return the new jobs."""
        with self.database.read() as stores:
            orders = [*self._refits(stores), *self._drift(stores, stores.spectra.stations())]
        return self._add(orders)

    def enqueue_drift(self, station: str) -> list[int]:
        """Enqueue the drift of a station, whose versions changed."""
        with self.database.read() as stores:
            orders = list(self._drift(stores, [station]))
        return self._add(orders)

    def _add(self, orders: list[Order]) -> list[int]:
        if not orders:
            return []
        with self.database.write() as stores:
            made = [stores.jobs.add(order, self.clock()) for order in orders]
        return [number for number in made if number is not None]

    def _refits(self, stores: Stores) -> Iterator[Order]:
        for since, until in _years(stores):
            filled = []
            for station in stores.spectra.stations():
                content = stores.spectra.content(Window(since, until, Scope(station)))
                if content[0] == 0:
                    continue
                filled.append((station, content))
                for scope in ("antenna", "station"):
                    yield self._refit(scope, Scope(station), since, until, content)
            if filled:
                yield self._refit("array", Scope(), since, until, filled)

    def _refit(self, scope: str, of: Scope, since: Instant, until: Instant, content: Any) -> Order:
        part = describe_part(scope, of, since, until, promote=True)
        due_key = hash_content([REFIT, part, content, self._inputs()])
        return Order(REFIT, part, [part], "new spectra in the window, or other inputs than before", BY, due_key)

    def _drift(self, stores: Stores, stations: list[str]) -> Iterator[Order]:
        for station in stations:
            references = find_references(stores, station)
            if not references:
                continue
            for since, until in _years(stores):
                content = stores.spectra.content(Window(since, until, Scope(station)))
                if content[0] == 0:
                    continue
                part = {"station": station, "since": since, "until": until}
                due_key = hash_content([DRIFT, part, content, sorted(references.values()), self._inputs()])
                yield Order(DRIFT, part, [part], "new spectra in the window, or another reference", BY, due_key)

    def _inputs(self) -> list[Any]:
        return [self.instrument.digest(), self.sky_power().digest(), MODEL_VERSION]


def _years(stores: Stores) -> Iterator[tuple[Instant, Instant]]:
    """The calendar years with events, as half-open windows."""
    span = stores.spectra.span()
    if span is None:
        return
    first, last = (datetime.fromtimestamp(instant / 1e6, UTC).year for instant in span)
    for year in range(first, last + 1):
        yield start_of_year(year), start_of_year(year + 1)


def start_of_year(year: int) -> Instant:
    """The first instant of a year, UTC."""
    return parse_instant("year", f"{year}-01-01")
