from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sqlalchemy

from lbacal_core.spectra.spectra import Spectra
from service.errors import ConflictError
from service.factory import Factory

MHZ = np.array([30.0, 45.0, 60.0, 80.0])


def spectra_of(events: int, name: str = "e") -> Spectra:
    return Spectra(
        frequency_mhz=MHZ,
        power=1.0 + np.arange(4.0 * events).reshape(events, 4),
        event_id=np.array([f"{name}{k:05d}" for k in range(events)]),
        time_unix=np.full(events, 1.4e9),
        station=np.full(events, "CS001"),
        antenna=np.zeros(events, dtype=np.int64),
        dipole=np.full(events, "X"),
        blocks=np.full(events, 100),
    )


def add(factory: Factory, spectra: Spectra) -> int:
    with factory.database.write() as stores:
        return stores.spectra.add(spectra)


@pytest.mark.long
def test_a_batch_of_more_events_than_a_statement_takes_parameters_is_stored_and_sent_again(factory: Factory) -> None:
    """65,536 events were 503 for ever on PostgreSQL, and the client went on sending them."""
    events = 66_000
    spectra = spectra_of(events)
    assert add(factory, spectra) == events
    assert add(factory, spectra) == 0
    blocks = spectra.blocks.copy()
    blocks[41_234] = 7
    with pytest.raises(ConflictError, match=r"dipole: e41234, CS001 antenna 0 X \(blocks\)$"):
        add(factory, replace(spectra, blocks=blocks))


def test_sending_again_asks_the_database_as_often_for_300_events_as_for_one(factory: Factory) -> None:
    """One query an event, and one pass over all rows for each: 64,000 events took 54 s."""
    statements: list[str] = []

    def record(*arguments: Any) -> None:
        statements.append(arguments[2])

    counts = []
    for events in (1, 300):
        spectra = spectra_of(events, name=f"of{events}-")
        add(factory, spectra)
        statements.clear()
        sqlalchemy.event.listen(factory.database.engine, "before_cursor_execute", record)
        assert add(factory, spectra) == 0
        sqlalchemy.event.remove(factory.database.engine, "before_cursor_execute", record)
        counts.append(len(statements))
    assert counts[0] == counts[1] > 0


def test_a_conflict_names_five_spectra_and_counts_the_rest(factory: Factory) -> None:
    spectra = spectra_of(9)
    add(factory, spectra)
    changed = replace(spectra, power=spectra.power * (1 + 1e-15), blocks=spectra.blocks + 1)
    with pytest.raises(ConflictError, match=r"e00000, CS001 antenna 0 X \(blocks, power\); .* and 4 more$"):
        add(factory, changed)
