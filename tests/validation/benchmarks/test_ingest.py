"""What the benchmark of ingestion compares does the same; the speeds themselves are no test."""

from __future__ import annotations

import os
from pathlib import Path

import psycopg
import pytest

from service.config import Settings
from service.factory import Factory
from validation.benchmarks.ingest import BulkPostgres, BulkSqlite, prepare
from validation.running.postgres import run_postgres


def count(url: str) -> int:
    factory = Factory(Settings(database_url=url))
    everything = {"station": None, "since": None, "until": None, "flag": None, "cursor": -1, "limit": 10}
    with factory.database.read() as stores:
        found = sum(event.spectra for event in stores.spectra.events(**everything))
    factory.database.close()
    return found


def require_once(bulk: BulkSqlite | BulkPostgres, url: str) -> None:
    bulk.add_keys(3, 2)
    for events in (1, 2, 2):
        bulk.load([(path, event, 0, 100, bytes(8)) for event in range(events) for path in range(3)])
        assert count(url) == 3 * events
    bulk.close()


def test_the_bulk_load_of_sqlite_stores_each_spectrum_once(tmp_path: Path) -> None:
    url = str(tmp_path / "bare.sqlite")
    prepare(url)
    require_once(BulkSqlite(url), url)


@pytest.mark.usefixtures("needs_postgres")
def test_the_bulk_load_of_postgresql_stores_each_spectrum_once() -> None:
    name = f"bulk_{os.getpid()}"
    with run_postgres() as server, psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
        url = server.replace("/postgres?", f"/{name}?", 1)
        prepare(url)
        require_once(BulkPostgres(url), url)
        connection.execute(f"DROP DATABASE {name} WITH (FORCE)")
