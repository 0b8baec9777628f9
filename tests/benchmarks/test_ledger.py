"""What the benchmark of the ledger times is what it names; the times themselves are no test."""

from __future__ import annotations

import pytest

from benchmarks.ledger import PATHS, deeds, fill
from service.config import Settings
from service.factory import Factory


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_each_deed_is_done_on_a_ledger_of_two_nights(database_url: str) -> None:
    factory = Factory(Settings(database_url=database_url))
    every = deeds(factory, fill(factory, 2))
    for deed in every.values():
        deed(0)
    with factory.database.read() as stores:
        newest = stores.ledger.newest_number()
    assert newest == 3 * len(PATHS) + sum(name.startswith("promotion") for name in every)
    factory.database.close()
