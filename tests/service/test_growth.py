"""Ten times the stations cost ten times the work, counted and not timed: a question of one walks nothing of others."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import event
from sqlalchemy.pool import Pool

from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import write_sky_power
from service.app import make_app
from service.factory import Factory
from service.scheduler import look_for_due_work
from tests.service.conftest import CHANNELS, MHZ, flat_spectra, instant, name_in_server, new_version
from validation.running.ledger import open_factory, write_promotions
from validation.running.postgres import open_databases

FEW, MANY, EVENTS, ANTENNAS = 5, 50, 60, 2
MOST_GROWTH = 1.3
"""Of the work for each station, or of a question about one."""
WHOLE = 100
"""Rows that PostgreSQL reads rather than the index of a table of one page, whatever is asked of it."""
STEPS_AT_ONCE = 10
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
        "frequency_mhz": MHZ, "dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}},
        "antenna_gain": [0.1] * CHANNELS, "receiver_gain": [1.0] * CHANNELS, "cables": {"80m": [0.5] * CHANNELS},
        "antennas": [{"station": s, "antenna": a, "cable": "80m"} for s in names for a in range(ANTENNAS)],
    }  # fmt: skip
    path = folder / f"{stations}.json"
    path.write_text(json.dumps(content))
    return path


def work_of(url: str, folder: Path, stations: int, counted: Callable[[Factory], int]) -> dict[str, float]:
    """The counted work of a service with so many stations: of all of it for each, of questions about one as it is."""
    path = make_instrument(folder, stations)
    instrument = load_instrument(str(path))
    sky = folder / f"sky-{stations}.json"
    write_sky_power(compute_sky_power(instrument, lst_hours=np.arange(24.0)), sky)
    names = sorted({record.station for record in instrument.antennas})
    with open_factory(url, instrument=str(path), sky_power=sky) as factory:
        client = TestClient(make_app(factory))

        def ingest() -> None:
            for name in names:
                rows = [
                    (f"e{k}", 1.4e9 + 1e5 * k, name, a, d) for k in range(EVENTS) for a in range(ANTENNAS) for d in "XY"
                ]
                with factory.database.write() as stores:
                    stores.spectra.add(flat_spectra(*rows))

        def fill() -> None:
            made = [new_version(Scope(n, a, d), f"{n}-{a}-{d}") for n in names for a in range(ANTENNAS) for d in "XY"]
            with factory.database.write() as stores:
                stores.versions.add(made)
            span = instant("2014-01-01"), instant("2015-01-01")
            write_promotions(factory, [Promotion(k, v.scope, *span, v.id, k) for k, v in enumerate(made, 1)])

        def ask(address: str, **params: Any) -> Callable[[], Any]:
            return lambda: client.get(address, params=params).raise_for_status()

        def work(do: Callable[[], Any], share: int) -> float:
            before = counted(factory)
            do()
            return (counted(factory) - before) / share

        found = {"ingest": work(ingest, stations)}
        found["look"] = work(lambda: look_for_due_work(factory), stations)
        found["look again"] = work(lambda: look_for_due_work(factory), stations)
        fill()
        found["effective, all"] = work(ask("/v1/calibrations/effective", at=DATE), stations)
        found["effective, one path"] = work(ask("/v1/calibrations/effective", at=DATE, **PATH), 1)
        found["life"] = work(ask("/v1/paths/CS001/0/X/life"), 1)
        found["events"] = work(ask("/v1/events"), stations)
        return found


@pytest.mark.long
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_fifty_stations_cost_ten_times_what_five_do(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """What was due was asked of every spectrum of all stations, station by station: 8.8 times the work for each."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    with open_databases(kind, "few", "many") as (few, many), counting_steps() as counted_steps:
        counted = counted_steps if kind == "sqlite" else count_rows
        small, large = (work_of(url, tmp_path, n, counted) for url, n in ((few, FEW), (many, MANY)))
    spare = 0 if kind == "sqlite" else WHOLE
    assert {name: (small[name], large[name]) for name in small if large[name] > MOST_GROWTH * small[name] + spare} == {}
