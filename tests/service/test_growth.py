"""Ten times the stations cost ten times the work, counted and not timed: a question of one walks nothing of others."""

from __future__ import annotations

import json
import sqlite3
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import event
from sqlalchemy.pool import Pool

from lbacal_core.calibration import chain_form
from lbacal_core.calibration.budget import compute_budget
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.drift.events import MODES, EventModes
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.provenance import Remembered
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import write_sky_power
from lbacal_core.spectra.screening import LASTING_EVENTS
from lbacal_core.spectra.spectra import Spectra
from service.app import make_app
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.schema.tables import metadata
from service.storage.jobs import Order
from service.storage.sums import DRIFT, Sums
from service.usecases import fits
from service.usecases.drift_measurement import write_events
from service.usecases.fits import read_fits
from service.usecases.intake import judge_far
from service.usecases.watch import KIND as WATCH
from tests.service.conftest import add_spectra, flat_spectra, get_job, instant, name_in_server, new_version, work
from validation.running.ledger import open_factory, write_promotions
from validation.running.postgres import open_databases

FEW, MANY, EVENTS, ANTENNAS = 5, 50, 60, 2
MOST_GROWTH = 1.3
"""Of the work for each station, or of a question about one."""
WHOLE = 100
"""Rows that PostgreSQL reads rather than the index of a table of one page, whatever is asked of it."""
EVENTS_OF_ARRAY, OF_A_PATH = 400, 5_000
"""Of a year whose memory is weighed, and bytes that are kept of a path without its spectra: lines and hashes."""
BEFORE_THAT = 20
"""Events for each station that a path has before those that wait."""
EVENTS_WATCHED, WATCHED, OF_A_SPECTRUM = 1_000, 6, 60
"""Of two years of as many antennas of a station, and bytes that the watch holds of a spectrum more."""
STEPS_AT_ONCE = 10
MEMORY = "memory of the array's year"
FREQUENCY_MHZ = [30.0, 40.0, 50.0, 60.0, 70.0, 80.0]
CHANNELS = len(FREQUENCY_MHZ)
DATE, PATH = "2014-06-01", {"station": "CS001", "antenna": 0, "dipole": "X"}


@contextmanager
def counting_steps() -> Iterator[Callable[[Factory], int]]:
    """Counts tens of steps of SQLite's machine, of all its connections from now on."""
    steps = [0]

    def count() -> int:
        steps[0] += 1
        return 0

    def watch(connection: Any, *_: Any) -> None:
        if isinstance(connection, sqlite3.Connection):
            connection.set_progress_handler(count, STEPS_AT_ONCE)

    event.listen(Pool, "checkout", watch)
    yield lambda _: steps[0]
    event.remove(Pool, "checkout", watch)


def count_rows(factory: Factory) -> int:
    """How many rows PostgreSQL read in the database of a service, by scans of tables and of indexes."""
    factory.database.close()  # what a connection counted is told at its end
    url = factory.settings.database_url
    name = name_in_server(url)
    with psycopg.connect(url.replace(f"/{name}?", "/postgres?", 1), autocommit=True) as connection:
        asked = "SELECT tup_returned + tup_fetched FROM pg_stat_database WHERE datname = %s"
        while connection.execute("SELECT count(*) FROM pg_stat_activity WHERE datname = %s", (name,)).fetchone() != (
            0,
        ):
            pass
        (rows,) = connection.execute(asked, (name,)).fetchone() or (0,)
    return int(rows)


def make_instrument(folder: Path, stations: int) -> Path:
    names = [f"CS{k:03d}" for k in range(stations)]
    content = {
        "name": f"{stations} small stations", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 50.0,
        "frequency_mhz": FREQUENCY_MHZ, "dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}},
        "antenna_gain": [0.1] * CHANNELS, "receiver_gain": [1.0] * CHANNELS, "cables": {"80m": [0.5] * CHANNELS},
        "antennas": [{"station": s, "antenna": a, "cable": "80m"} for s in names for a in range(ANTENNAS)],
    }  # fmt: skip
    path = folder / f"{stations}.json"
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def quick_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits with the budget of the first, and the published form of the chain: what is fitted is of no matter here."""
    budgets = Remembered[str, Budget](1)
    monkeypatch.setattr(fits, "compute_budget", lambda *of: budgets.get("any", lambda: compute_budget(*of)))
    monkeypatch.setattr(chain_form, "_compare_forms", lambda *_: chain_form.PUBLISHED_FORM)


def under_a_sky(spectra: Spectra) -> Spectra:
    """Spectra that rise and fall once a sidereal day, with 3 % of scatter, so that a night can fit them."""
    lst = local_sidereal_time(spectra.time_unix, 6.9)
    scatter = np.random.default_rng(1).normal(1.0, 0.03, (len(spectra), CHANNELS))
    power = (1.0 + 0.3 * np.cos(2 * np.pi * (lst - 18.0) / 24.0))[:, None] * scatter
    return replace(spectra, frequency_mhz=np.array(FREQUENCY_MHZ), power=power)


def keep_still(factory: Factory) -> None:
    """Let PostgreSQL not look at its tables by itself, which reads rows whenever a minute is over."""
    if factory.database.engine.dialect.name == "postgresql":
        with factory.database.engine.begin() as connection:
            for name in metadata.tables:
                connection.exec_driver_sql(f"ALTER TABLE {name} SET (autovacuum_enabled = false)")


def let_wait(factory: Factory, before: int) -> None:
    """Spectra of one path that wait, behind others, in tables whose size PostgreSQL knows."""
    rows = [(f"f{k}", 1.41e9 + k, *PATH.values()) for k in range(before + LASTING_EVENTS)]
    far = np.where(np.arange(len(rows)) < before, np.nan, 30.0)
    with factory.database.write() as stores:
        stores.spectra.add(under_a_sky(flat_spectra(*rows)), far)
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("ANALYZE")


def judge(factory: Factory) -> None:
    with factory.database.write() as stores:
        assert judge_far(stores) == LASTING_EVENTS


def weigh_array(factory: Factory) -> int:
    """The most memory that a fit of the array's year takes, bytes, beside a hundred fits that are remembered."""
    new = replace(factory.fits, simulation=replace(factory.simulation, most_remembered=FEW))
    tracemalloc.start()
    with factory.database.read() as stores:
        wanted = read_fits(stores, None)("array", Scope(), instant("2015-01-01"), instant("2016-01-01"))
        made = new.make(new.fit_causes(new.load(stores, wanted), Model()), wanted)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [curve.dipole for one in made.versions for curve in one.curves if curve.c is not None] == ["X", "Y"]
    return most


def work_of(
    url: str,
    folder: Path,
    stations: int,
    counted: Callable[[Factory], int],
    simulations: dict[tuple[str, Any], Simulation],
) -> dict[str, float]:
    """The counted work of a service with so many stations: of all of it for each, of questions about one as it is."""
    path = make_instrument(folder, stations)
    instrument = load_instrument(str(path))
    sky = folder / f"sky-{stations}.json"
    write_sky_power(compute_sky_power(instrument, lst_hours=np.arange(24.0)), sky)
    names = sorted({record.station for record in instrument.antennas})
    with open_factory(url, instrument=str(path), sky_power=sky, nightly_investigations=False) as factory:
        keep_still(factory)
        fitted = replace(factory.simulation, most_remembered=1000)
        factory.simulation = simulations.setdefault(
            (fitted.digest, ""), fitted
        )  # another database has the same spectra
        client = TestClient(make_app(factory))

        def ingest(times: Sequence[float] = 1.4e9 + 1e5 * np.arange(EVENTS)) -> None:
            for name in names:
                rows = [(f"e{t:.0f}", t, name, a, d) for t in times for a in range(ANTENNAS) for d in "XY"]
                add_spectra(factory, under_a_sky(flat_spectra(*rows)))

        def fill() -> None:
            made = [new_version(Scope(n, a, d), f"{n}-{a}-{d}") for n in names for a in range(ANTENNAS) for d in "XY"]
            with factory.database.write() as stores:
                stores.versions.add(made)
            span = instant("2014-01-01"), instant("2015-01-01")
            write_promotions(factory, [Promotion(k, v.scope, *span, v.id, k) for k, v in enumerate(made, 1)])

        def ask(address: str, **params: Any) -> Callable[[], Any]:
            return lambda: client.get(address, params=params).raise_for_status()

        def count(do: Callable[[], Any], share: int) -> float:
            before = counted(factory)
            do()
            return (counted(factory) - before) / share

        due: list[int] = []

        def pass_night() -> None:
            work(factory)
            ended = {(get_job(factory, job).state, *get_job(factory, job).errors) for job in due}
            assert ended == {("done",)}

        found = {"ingest": count(ingest, stations)}
        found["look"] = count(lambda: due.extend(look_for_due_work(factory)), stations)
        found["look again"] = count(lambda: look_for_due_work(factory), stations)
        found["night"] = count(pass_night, stations)
        fill()
        found["effective, all"] = count(ask("/v1/calibrations/effective", at=DATE), stations)
        found["effective, one path"] = count(ask("/v1/calibrations/effective", at=DATE, **PATH), 1)
        found["life"] = count(ask("/v1/paths/CS001/0/X/life"), 1)
        found["events"] = count(ask("/v1/events"), stations)
        let_wait(factory, BEFORE_THAT * stations)
        found["spectra that wait"] = count(lambda: judge(factory), 1)
        ingest(np.linspace(1.42e9, 1.45e9, EVENTS_OF_ARRAY))
        found[MEMORY] = weigh_array(factory)
        return found


@pytest.mark.long
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
@pytest.mark.usefixtures("quick_fits")
def test_fifty_stations_cost_ten_times_what_five_do(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest, simulations: dict[tuple[str, Any], Simulation]
) -> None:
    """What was due was asked of every spectrum of all stations, station by station: 8.8 times the work for each."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    with open_databases(kind, "few", "many") as (few, many), counting_steps() as counted_steps:
        counted = counted_steps if kind == "sqlite" else count_rows
        small, large = (work_of(url, tmp_path, n, counted, simulations) for url, n in ((few, FEW), (many, MANY)))
    weights = [found.pop(MEMORY) for found in (small, large)]
    assert weights[1] < MOST_GROWTH * weights[0] + OF_A_PATH * MANY * ANTENNAS * 2, "one station's spectra at a time"
    spare = 0 if kind == "sqlite" else WHOLE
    assert {name: (small[name], large[name]) for name in small if large[name] > MOST_GROWTH * small[name] + spare} == {}


def weigh_watch(factory: Factory, stations: int) -> int:
    """The most memory that the watch of so many stations takes, bytes."""
    rng, span = np.random.default_rng(stations), (instant("2014-01-01"), instant("2016-01-01"))
    time_unix = np.linspace(*span, EVENTS_WATCHED, endpoint=False) / 1e6
    with factory.database.write() as stores:
        for k in range(stations):
            ln_c = 0.01 * rng.standard_normal((2, WATCHED, EVENTS_WATCHED, len(MODES)))
            arrays = write_events(
                {d: EventModes(np.arange(WATCHED), time_unix, of) for d, of in zip("XY", ln_c, strict=True)}
            )
            stores.sums.put(Sums(DRIFT, Scope(f"CS{k:03d}"), *span, "", 0, 0, 0, 0, arrays))
        stores.jobs.add(Order(WATCH, {}, [{}], "test", "test"), factory.clock())
    tracemalloc.start()
    work(factory)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    report = factory.database.look(lambda stores: stores.drift.report()) or {}
    assert len(report["slopes"]) == 2 * (WATCHED + 1) * stations
    return most


@pytest.mark.long
def test_the_watch_holds_its_events_and_their_medians_alone(factory: Factory) -> None:
    """It held all years three times, and everything that it computed of all spectra at once."""
    few, many = (weigh_watch(factory, stations) for stations in (FEW, MANY))
    assert many - few < OF_A_SPECTRUM * (MANY - FEW) * 2 * WATCHED * EVENTS_WATCHED
