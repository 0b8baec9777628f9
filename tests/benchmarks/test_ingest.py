"""What the benchmark of ingestion compares does the same; the speeds themselves are no test."""

from __future__ import annotations

from benchmarks.ingest import BulkPostgres, BulkSqlite
from service.factory import Factory


def test_the_bulk_load_stores_each_spectrum_once(factory: Factory, database_url: str) -> None:
    bulk = BulkPostgres(database_url) if database_url.startswith("postgresql") else BulkSqlite(database_url)
    bulk.add_keys(3, 2)
    for events in (1, 2, 2):
        bulk.load([(path, event, 0, 100, bytes(8)) for event in range(events) for path in range(3)])
        with factory.database.read() as stores:
            assert sum(event.spectra for event in stores.spectra.events(
                station=None, since=None, until=None, flag=None, cursor=-1, limit=10
            )) == 3 * events  # fmt: skip
