from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sqlalchemy

from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.errors import ConflictError
from service.factory import Factory
from service.storage.spectra import Window
from tests.service.conftest import add_spectra, flat_spectra

CHANNELS = 51
FREQUENCY = np.linspace(30.0, 80.0, CHANNELS)
START = 1.4e9
EVERYTHING = Window(0, 2 * round(START * 1e6))


def make_spectra(events: int, antennas: int) -> Spectra:
    rows = events * antennas * 2
    event, antenna, dipole = np.unravel_index(np.arange(rows), (events, antennas, 2))
    rng = np.random.default_rng(7)
    return Spectra(
        frequency_mhz=FREQUENCY,
        power=1.0 + rng.random((rows, CHANNELS)),
        event_id=np.array([f"L{(k * 7919) % 10_000:05d}" for k in event]),  # not in order of time
        time_unix=START + 100.0 * event,
        station=np.full(rows, "CS002"),
        antenna=antenna,
        dipole=np.array(["X", "Y"])[dipole],
        blocks=np.full(rows, 100),
        environment={"temperature_c": np.full(rows, 10.0)},
    )


def load(factory: Factory, window: Window) -> Spectra | None:
    with factory.database.read() as stores:
        return stores.spectra.load(window, FREQUENCY, 50.0)


def test_what_is_read_is_what_was_stored(factory: Factory) -> None:
    spectra = make_spectra(30, 3)
    add_spectra(factory, spectra)
    found = load(factory, EVERYTHING)
    assert found is not None
    assert found.digest() == spectra.digest()
    assert found.environment == {}, "fits use no covariates, however many names they have"
    path = load(factory, Window(0, round((START + 950.0) * 1e6), Scope("CS002", 2, "Y")))
    assert path is not None
    own = (spectra.antenna == 2) & (spectra.dipole == "Y") & (spectra.time_unix < START + 950.0)
    assert path.digest() == spectra.select(own).digest()
    with factory.database.write() as stores:
        stores.spectra.set_flag(str(spectra.event_id[0]), "x", reason="test", by="test", at=0)
    left = load(factory, EVERYTHING)
    assert left is not None
    assert left.digest() == spectra.select(spectra.event_id != spectra.event_id[0]).digest()
    assert load(factory, Window(0, 1)) is None


def test_a_window_is_read_without_a_second_copy_of_it(factory: Factory) -> None:
    """A refit of the array read its whole window as rows of Python: 2.2 times the memory, 7.5 GB for seven years."""
    spectra = make_spectra(400, 12)
    add_spectra(factory, spectra)
    load(factory, Window(0, round((START + 50.0) * 1e6)))  # what is imported and prepared once is not counted
    tracemalloc.start()
    found = load(factory, EVERYTHING)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found is not None
    columns = ("power", "event_id", "time_unix", "station", "antenna", "dipole", "blocks")
    size = sum(getattr(found, name).nbytes for name in columns)
    # one path at a time (1/24 of the whole, twice: as rows and joined), codes of the key, and arrays of True and False
    assert peak < 1.5 * size


def spectra_of(events: int, name: str = "e") -> Spectra:
    return flat_spectra(*[(f"{name}{k:05d}", 1.4e9, "CS001", 0, "X") for k in range(events)])


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
