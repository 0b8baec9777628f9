"""What the refits of a night cost: .venv/bin/python -m validation.benchmarks.refits [STATIONS [ANTENNAS [EVENTS]]].

A service on SQLite holds a year of some stations. Its first night makes all calibrations, the second measures drift
against them; then one event arrives, and the third looks at everything again. At last the year of two stations is
investigated. One worker does all this, and on a copy two. Processor time is that of all workers, wall time that of the
night; reading, in which spectra and kept fits come from the database, stands by itself. The reference is the bare fit
of the same spectra, each scope by itself without errors, in the same run. A campaign of more years has as many windows
more, which share nothing: it costs the time of a year as often.
"""

from __future__ import annotations

import multiprocessing
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.sky.table import write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.config import Settings
from service.factory import Factory
from service.storage.migration import upgrade
from service.storage.spectra import SpectraStore
from service.storage.sums import SumStore
from service.usecases.drift_measurement import KIND as DRIFT
from service.usecases.investigations import KIND as INVESTIGATION
from service.usecases.refits import KIND as REFIT
from service.usecases.watch import KIND as WATCH
from service.wire.bodies import InvestigationBody

STATIONS = ("CS002", "CS003", "CS004", "CS005", "CS006", "CS007")
INVESTIGATED = 2
READING = "reading"
Seconds = Counter[str]
"""Seconds of processor time by kind of work, without reading; and of reading."""


def open_service(folder: Path) -> Factory:
    settings = Settings(
        database_url=str(folder / "refits.sqlite"), sky_power=folder / "sky_power.json", nightly_investigations=False
    )
    return Factory(settings)


def work(folder: Path, _: int = 0) -> Seconds:
    factory, spent = open_service(folder), Counter[str]()
    deeds = {
        REFIT: factory.refits.run, DRIFT: factory.drift_measurement.run, WATCH: factory.watch.run,
        INVESTIGATION: factory.investigations.run,
    }  # fmt: skip
    for store, name in ((SpectraStore, "load"), (SumStore, "get")):
        setattr(store, name, _timed(getattr(store, name), spent))
    with threadpool_limits(1):
        _ = factory.simulation.sky_power, factory.simulation.prior
        while True:
            with factory.database.write() as stores:
                part = stores.jobs.claim("benchmark", lease_us=10**9, inputs=factory.inputs.text)
            if part is None:
                factory.database.close()
                return spent
            begin, read = time.process_time(), spent[READING]
            deeds[part.kind](part, "benchmark")
            spent[part.kind] += time.process_time() - begin - (spent[READING] - read)


def _timed(method: Any, spent: Seconds) -> Any:
    """A method whose processor time counts as reading."""

    def call(*arguments: Any, **options: Any) -> Any:
        begin = time.process_time()
        try:
            return method(*arguments, **options)
        finally:
            spent[READING] += time.process_time() - begin

    return call


def night(folder: Path, workers: int) -> tuple[Seconds, float]:
    factory = open_service(folder)
    factory.due.enqueue()
    factory.database.close()
    return share(folder, workers)


def investigations(folder: Path, workers: int, stations: Sequence[str]) -> tuple[Seconds, float]:
    """Investigate the year of some stations."""
    factory = open_service(folder)
    for station in stations:
        body = {"since": "2014-01-01", "until": "2015-01-01", "station": station, "reason": "benchmark"}
        factory.investigations.request(InvestigationBody.model_validate(body), "benchmark")
    factory.database.close()
    return share(folder, workers)


def share(folder: Path, workers: int) -> tuple[Seconds, float]:
    """Do what is open; processor time, and wall time with the start of the workers."""
    begin = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        spent = sum(pool.imap_unordered(partial(work, folder), range(workers)), Counter[str]())
    return spent, time.perf_counter() - begin


def tell(what: str, spent: Seconds, wall: float, bare: float) -> None:
    own = ", ".join(f"{kind} {seconds:.2f} s" for kind, seconds in sorted(spent.items()))
    beyond = sum(spent.values()) - spent[READING]
    print(f"{what}: {own}; {beyond / bare:.2f} of the bare fits beyond reading; {wall:.1f} s of wall time", flush=True)


def run(folder: Path, stations: int, antennas: int, events: int) -> None:
    factory = open_service(folder)
    shipped = Factory(Settings())
    write_sky_power(shipped.simulation.sky_power, folder / "sky_power.json")
    settings = TwinSettings(stations=STATIONS[:stations], antennas=antennas, events_per_year=events + 1, years=0.999)
    spectra = simulate_campaign(
        settings, factory.instrument, factory.simulation.sky_power, np.random.default_rng(1)
    ).spectra
    last = spectra.event_id == spectra.event_id[np.argmax(spectra.time_unix)]
    upgrade(factory.database)
    store(factory, spectra.select(~last))
    with threadpool_limits(1):
        begin = time.process_time()
        for scope in ("antenna", "station", "array"):
            fit_calibration(spectra, factory.simulation, scope)
        bare = time.process_time() - begin
    curves = 2 * (stations * antennas + stations + 1)
    print(f"{curves} curves of {events} events: bare fits {bare:.2f} s, {1e3 * bare / curves:.1f} ms a curve")
    for workers in (1, 2):
        own = folder / f"by {workers}"
        shutil.copytree(folder, own, ignore=shutil.ignore_patterns("by *"))
        tell(f"first night, {workers} at work", *night(own, workers), bare)
        tell(f"second night, {workers} at work", *night(own, workers), bare)
        store(open_service(own), spectra.select(last))
        tell(f"after one more event, {workers} at work", *night(own, workers), bare)
        asked = STATIONS[: min(stations, INVESTIGATED)]
        tell(
            f"{len(asked)} stations' years in which nothing is hidden investigated, {workers} at work",
            *investigations(own, workers, asked), bare,
        )  # fmt: skip
    factory.database.close()


def store(factory: Factory, spectra: Spectra) -> None:
    with factory.database.write() as stores:
        stores.spectra.add(spectra)


def main(arguments: Any) -> None:
    stations, antennas, events = [*map(int, arguments), *(1, 48, 900)[len(arguments) :]]
    with tempfile.TemporaryDirectory(prefix="lbacal-refits-") as name:
        run(Path(name), stations, antennas, events)


if __name__ == "__main__":
    main(sys.argv[1:])
