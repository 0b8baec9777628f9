"""Speed of ingestion over HTTP, as ratios measured in one run.

Run: python -m validation.benchmarks.ingest [EVENTS]

One event (576 spectra of 51 channels) a request and one client, as JSON and as a spectra file, against the idempotent
bulk load of the database by its own driver: into an empty table of the same schema, many events in one transaction,
from values that are ready (SQLite: executemany with ON CONFLICT DO NOTHING; PostgreSQL: COPY into a staging table, then
INSERT ... ON CONFLICT DO NOTHING). Measured beside: the same with one event a transaction, which is as many commits as
the server makes when one event comes in each request; that again from bodies, which a loader in this process reads as
fast as we know how, sends nowhere and does not check; four clients at once; sending again; and `lbacal ingest`. The
kinds take turns, so that other work on the machine meets all; rates are medians.
"""

from __future__ import annotations

import json
import sqlite3
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain, count
from pathlib import Path

import httpx2
import jiter
import numpy as np
import psycopg

from lbacal.client import Client
from lbacal.transport import files_of_events
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.spectra.spectra import Spectra, read_columns
from service.handlers.request import HDF5
from validation.benchmarks.timing import time_once
from validation.running.clients import bodies_of_events
from validation.running.ledger import open_factory
from validation.running.postgres import open_databases
from validation.running.processes import run_service

TURNS = 6
LOADS = 4
"""Kinds of bulk load."""
CLIENTS = 4
APART = "bulk load, one event a transaction"
Row = tuple[int, int, int, int, bytes]


def make_spectra(events: int, first: int, rng: np.random.Generator) -> Spectra:
    """Events of the whole Superterp, with powers of 17 digits."""
    instrument = load_instrument("lofar-superterp")
    paths = [(r.station, r.antenna, d) for r in instrument.antennas for d in "XY"]
    rows = events * len(paths)
    return Spectra(
        frequency_mhz=instrument.frequency_mhz,
        power=rng.lognormal(-6.0, 1.0, (rows, instrument.frequency_mhz.size)),
        event_id=np.repeat([f"{first + k}" for k in range(events)], len(paths)),
        time_unix=np.repeat(1.4e9 + 3600.0 * np.arange(first, first + events), len(paths)),
        station=np.tile([path[0] for path in paths], events),
        antenna=np.tile([path[1] for path in paths], events),
        dipole=np.tile([path[2] for path in paths], events),
        blocks=np.full(rows, 100),
        environment={"temperature_c": np.repeat(rng.normal(10.0, 5.0, events), len(paths))},
    )


class BulkSqlite:
    """Rows that SQLite's own driver stores in a second."""

    def __init__(self, url: str) -> None:
        self._connection = sqlite3.connect(url, isolation_level=None)
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            self._connection.execute(f"PRAGMA {pragma}")

    def add_keys(self, paths: int, events: int) -> None:
        """The paths and events that the rows refer to."""
        self._connection.executemany("INSERT INTO path VALUES (?, ?, 0, 'X')", [(k, str(k)) for k in range(paths)])
        events_of = [(k, str(k)) for k in range(events)]
        self._connection.executemany("INSERT INTO event (id, event_id, time_us) VALUES (?, ?, 0)", events_of)

    def close(self) -> None:
        """Give the connection back."""
        self._connection.close()

    def load(self, rows: Sequence[Row]) -> None:
        """Store what is not there, in one transaction."""
        self._connection.execute("BEGIN IMMEDIATE")
        insert = "INSERT INTO spectrum (path, event, time_us, blocks, power) VALUES (?, ?, ?, ?, ?)"
        self._connection.executemany(f"{insert} ON CONFLICT DO NOTHING", rows)
        self._connection.execute("COMMIT")


class BulkPostgres:
    """Rows that PostgreSQL's own driver stores in a second."""

    def __init__(self, url: str) -> None:
        self._connection = psycopg.connect(url)

    def add_keys(self, paths: int, events: int) -> None:
        """The paths and events that the rows refer to."""
        self._connection.execute(
            "INSERT INTO path SELECT k, k::text, 0, 'X' FROM generate_series(0, %s) AS k", [paths - 1]
        )
        self._connection.execute(
            "INSERT INTO event (id, event_id, time_us) SELECT k, k::text, 0 FROM generate_series(0, %s) AS k",
            [events - 1],
        )
        self._connection.commit()

    def close(self) -> None:
        """Give the connection back."""
        self._connection.close()

    def load(self, rows: Sequence[Row]) -> None:
        """Store what is not there, in one transaction."""
        with self._connection.cursor() as cursor:
            cursor.execute("CREATE TEMP TABLE staging (LIKE spectrum) ON COMMIT DROP")
            with cursor.copy("COPY staging (path, event, time_us, blocks, power) FROM STDIN (FORMAT BINARY)") as copy:
                copy.set_types(["int4", "int8", "int8", "int4", "bytea"])
                for row in rows:
                    copy.write_row(row)
            cursor.execute("INSERT INTO spectrum SELECT * FROM staging ORDER BY event, path ON CONFLICT DO NOTHING")
        self._connection.commit()


def read_text(body: bytes) -> Floats:
    return np.array([spectrum["power"] for spectrum in jiter.from_json(body)["spectra"]])


def read_file(body: bytes) -> Floats:
    return np.asarray(read_columns(body, "body", 1 << 26)["power"])


def make_rows(powers: Floats, event: int) -> list[Row]:
    return [(k, event, 0, 100, power.tobytes()) for k, power in enumerate(powers)]


def compare(name: str, database_url: str, bulk: BulkSqlite | BulkPostgres, events: int) -> None:
    rng = np.random.default_rng(0)
    rates: dict[str, list[float]] = {}
    batches, free = count(), count()
    with (
        tempfile.TemporaryDirectory() as folder,
        run_service(database_url, Path(folder), log_level="warning", max_rate=100_000) as service,
        httpx2.Client(base_url=service.address, timeout=60.0) as http,
        Client(service.address, service.key) as client,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        http.headers["Authorization"] = f"Bearer {service.key}"

        def send(bodies: Sequence[bytes], media: str) -> None:
            for body in bodies:
                http.post("/v1/spectra", content=body, headers={"Content-Type": media}).raise_for_status()

        def send_at_once(bodies: Sequence[bytes], media: str) -> None:
            list(pool.map(lambda k: send(bodies[k::CLIENTS], media), range(CLIENTS)))

        def load(bodies: Sequence[bytes], read: Callable[[bytes], Floats]) -> None:
            for body in bodies:
                bulk.load(make_rows(read(body), next(free)))

        def make() -> Spectra:
            return make_spectra(events, next(batches) * events, rng)

        rows = len(make())
        bulk.add_keys(rows // events, LOADS * TURNS * events)
        for _ in range(TURNS):
            ready = [make_rows(power, next(free)) for power in np.split(make().power, events)]
            apart = [make_rows(power, next(free)) for power in np.split(make().power, events)]
            texts, more_texts = ([json.dumps(body).encode() for body in bodies_of_events(make())] for _ in range(2))
            files, more_files = ([file for *_, file in files_of_events(make())] for _ in range(2))
            works: dict[str, Callable[[], object]] = {
                "bulk load": partial(bulk.load, list(chain.from_iterable(ready))),
                APART: partial(lambda each: [bulk.load(some) for some in each], apart),
                f"{APART}, from JSON": partial(load, texts, read_text),
                f"{APART}, from files": partial(load, files, read_file),
                "JSON": partial(send, texts, "application/json"),
                "JSON again": partial(send, texts, "application/json"),
                f"JSON, {CLIENTS} clients": partial(send_at_once, more_texts, "application/json"),
                "HDF5": partial(send, files, HDF5),
                "HDF5 again": partial(send, files, HDF5),
                f"HDF5, {CLIENTS} clients": partial(send_at_once, more_files, HDF5),
                "lbacal ingest": partial(client.ingest, by_client := make()),
                "lbacal ingest again": partial(client.ingest, by_client),
            }
            for what, work in works.items():
                rates.setdefault(what, []).append(rows / time_once(work)[1])
    median = {what: float(np.median(found[1:])) for what, found in rates.items()}  # the first turn warms up
    print(f"{name}: {TURNS - 1} turns of {events} events x {rows // events} spectra")
    for what, found in median.items():
        of_bulk = f"{found / median['bulk load']:.2f} of the bulk load, {found / median[APART]:.2f} of that by event"
        again = f", {median[what.removesuffix(' again')] / found:.2f} of the time of sending" if "again" in what else ""
        print(f"  {what}: {found:,.0f} spectra/s, {of_bulk}{again}")


def main(events: int = 10) -> None:
    for kind, bulk in (("sqlite", BulkSqlite), ("postgresql", BulkPostgres)):
        with open_databases(kind, "ours", "bare") as (ours, bare), open_factory(bare):
            compare(kind, ours, bulk(bare), events)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
