"""Speed of reading, as ratios measured in one run: .venv/bin/python -m validation.benchmarks.reads [EVENTS].

The answer about one path, asked of the whole application but through no socket, is compared with a route that returns
the same object, as JSON and through the same middleware, and all 576 paths with 576 requests; in an array nine times as
large, all 5,184 paths with a route that sends the same bytes from memory. A year of a path, read into arrays from 6000
events of 576 spectra, is compared with the bare driver that fetches the rows of the same statement. Times are medians.
How requests grow with what is stored `./dev prove growth` says.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from fastapi import FastAPI, Request, Response
from sqlalchemy import event

from lbacal.instants import parse_instant
from lbacal_core.curves.covariance import Budget, BudgetTerm, CurveCovariance
from lbacal_core.curves.curves import Parameter
from lbacal_core.curves.validity import Promotion, Scope
from service.app import make_app
from service.cli.opening import configure_logs
from service.factory import Factory
from service.handlers.request import MAY_READ, answer
from service.storage.spectra import Window
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from validation.benchmarks.ingest import make_spectra
from validation.benchmarks.timing import median_times
from validation.growth import FIRST, INSTRUMENT, PATHS, make_version
from validation.running.ledger import open_factory, write_promotions
from validation.running.postgres import open_databases

TURNS, YEAR_TURNS = 41, 11
COPIES = 9
"""So many Superterps make an array of 5,184 paths."""
EVENTS_AT_ONCE = 20
EVENT_SPACING_S = 365.25 * 86_400 / 900
ALL = f"/v1/calibrations/effective?at={FIRST}-06-01"
ONE = f"{ALL}&station=CS002&antenna=17&dipole=X"
PATH_YEAR = Window(parse_instant("", "2014-05-13"), parse_instant("", "2015-05-13"), Scope("CS002", 17, "X"))


def enrich(versions: Iterable[Version], rng: np.random.Generator) -> tuple[Budget, list[Version]]:
    """Versions with all that curves of fits carry, and the budget to which they refer."""
    size = INSTRUMENT.frequency_mhz.size
    terms = [
        BudgetTerm(f"term {k}", "benchmark", {dipole: rng.normal(0.0, 0.05, (count, size)) for dipole in "XY"})
        for k, count in enumerate((5, 3, 2, 1, 1))
    ]
    budget = Budget(INSTRUMENT.frequency_mhz, tuple(terms))
    more: dict[str, Any] = {
        "c_sigma_sys": np.full(size, 2e-6),
        "parameters": {name: Parameter(*rng.lognormal(size=2)) for name in ("n_lna", "n_rcu", "n_adc")},
        "antenna_gain": INSTRUMENT.antenna_gain,
        "chi2_per_dof_profiled": 1.0,
        "covariance": CurveCovariance(
            rng.normal(0.0, 0.01, (4, size)), np.full(size, 1e-5), budget.digest, rng.normal(0.0, 0.01, (1, size))
        ),
    }
    return budget, [replace(one, curves=tuple(replace(curve, **more) for curve in one.curves)) for one in versions]


def calibrate(factory: Factory, paths: Sequence[Scope], rng: np.random.Generator) -> None:
    """Store a version of every path, with all that curves of fits carry, and put it into effect."""
    budget, versions = enrich([make_version(path, FIRST, 0, rng) for path in paths], rng)
    with factory.database.write() as stores:
        stores.budgets.add({budget.digest: budget})
        stores.versions.add(versions)
    write_promotions(factory, (Promotion(0, v.scope, *v.window, v.id, v.made, "benchmark", "night") for v in versions))


def fill(factory: Factory, events: int) -> None:
    """Store a version of every path, and events of the array, 900 a year."""
    rng = np.random.default_rng(0)
    calibrate(factory, PATHS, rng)
    for first in range(0, events, EVENTS_AT_ONCE):
        spectra = make_spectra(min(EVENTS_AT_ONCE, events - first), first, rng)
        times = 1.4e9 + EVENT_SPACING_S * spectra.event_id.astype(float)
        with factory.database.write() as stores:
            stores.spectra.add(replace(spectra, time_unix=times))
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("ANALYZE")


async def get(app: FastAPI, address: str) -> bytes:
    """The body of the answer to a request, passed to the application without a socket."""
    path, _, query = address.partition("?")
    parts: list[bytes] = []
    status, is_asked = 0, asyncio.Event()

    async def receive() -> dict[str, Any]:
        if is_asked.is_set():  # nobody hangs up
            await asyncio.Event().wait()
        is_asked.set()
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Mapping[str, Any]) -> None:
        nonlocal status
        status = message.get("status", status)
        parts.append(message.get("body", b""))

    scope = {
        "type": "http", "http_version": "1.1", "method": "GET", "path": path, "raw_path": path.encode(), "headers": [],
        "query_string": query.encode(), "scheme": "http", "server": ("benchmark", 80), "client": None, "state": {},
        "asgi": {"version": "3.0"}, "root_path": "",
    }  # fmt: skip
    await app(scope, receive, send)
    if status != 200:
        raise RuntimeError(f"{address}: {status}")
    return b"".join(parts)


def add_same(app: FastAPI, content: Any) -> None:
    """Add a route that returns an object as JSON: what any answer of this size costs."""

    @app.get("/same", dependencies=[MAY_READ])
    def same(request: Request) -> Response:
        return answer(request, content)


async def in_turn(works: Mapping[str, Callable[[], Awaitable[object]]], turns: int) -> dict[str, float]:
    """Median time of each work, s; they take turns."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(turns):
        for name, work in works.items():
            started = time.perf_counter()
            await work()
            times[name].append(time.perf_counter() - started)
    return {name: float(np.median(found[1:])) for name, found in times.items()}


async def compare_answers(factory: Factory) -> None:
    """Print what an answer costs beside its object."""
    app = make_app(factory)
    add_same(app, json.loads(await get(app, ONE)))
    took = await in_turn({address: partial(get, app, address) for address in (ONE, "/same")}, TURNS)
    # by itself: what comes after two megabytes pays for their memory
    took |= await in_turn({ALL: partial(get, app, ALL)}, TURNS)
    one, same, every = (1e3 * took[address] for address in (ONE, "/same", ALL))
    print(f"  one path {one:.2f} ms, the same object {same:.2f} ms: {same / one:.2f} of its speed")
    print(f"  all {len(PATHS)} paths {every:.0f} ms: 1/{len(PATHS) * one / every:.0f} of so many requests")


async def compare_with_bytes(factory: Factory) -> None:
    """Print what the answer about all paths of a large array costs beside its bytes."""
    antennas = [replace(one, station=f"{one.station}{k}") for k in range(COPIES) for one in INSTRUMENT.antennas]
    factory.instrument = replace(INSTRUMENT, antennas=tuple(antennas))
    paths = select_paths(factory.instrument, None, None, None)
    calibrate(factory, paths, np.random.default_rng(1))
    app = make_app(factory)
    started = time.perf_counter()
    body = await get(app, ALL)
    first = time.perf_counter() - started

    @app.get("/bytes", dependencies=[MAY_READ])
    def same() -> Response:
        return Response(body, media_type="application/json")

    took = await in_turn({address: partial(get, app, address) for address in (ALL, "/bytes")}, YEAR_TURNS)
    every, sent = 1e3 * took[ALL], 1e3 * took["/bytes"]
    print(f"  all {len(paths)} paths {every:.0f} ms, {len(body) / 1e6:.0f} MB from memory {sent:.0f} ms: ", end="")
    print(f"{every / sent:.2f}; by a server that has just started {first:.1f} s")


def compare_a_year(factory: Factory) -> None:
    """Print what a path's year costs, as a fit reads it, beside the bare driver with the same statement."""
    statements: list[tuple[str, Any]] = []

    @event.listens_for(factory.database.engine.__class__, "before_cursor_execute")
    def _note(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        statements.append((statement, parameters))

    def load() -> int:
        with factory.database.read() as stores:
            spectra = stores.spectra.load(PATH_YEAR, INSTRUMENT.frequency_mhz, 50.0)
            return 0 if spectra is None else len(spectra)

    rows = load()
    event.remove(factory.database.engine.__class__, "before_cursor_execute", _note)
    statement, parameters = max(statements, key=lambda one: "power" in one[0])

    def fetch() -> int:
        with factory.database.connect() as connection:
            cursor = connection.connection.cursor()
            cursor.execute(statement, parameters)
            return len(cursor.fetchall())

    if fetch() != rows:
        raise RuntimeError("the driver should fetch the same rows")
    took = median_times({"ours": lambda _: load(), "bare": lambda _: fetch()}, YEAR_TURNS)
    ours, bare = 1e3 * took["ours"], 1e3 * took["bare"]
    print(f"  a path's year, {rows} spectra: {ours:.1f} ms, the bare driver {bare:.1f} ms: {ours / bare:.2f}")


def main(events: int = 6000) -> None:
    configure_logs("warning")
    for kind in ("sqlite", "postgresql"):
        with open_databases(kind, "reads") as (url,), open_factory(url) as factory:
            fill(factory, events)
            print(f"{kind}: {576 * events:,} spectra, medians of {TURNS - 1} turns")
            asyncio.run(compare_answers(factory))
            compare_a_year(factory)
        with open_databases(kind, "large") as (url,), open_factory(url) as factory:
            asyncio.run(compare_with_bytes(factory))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
