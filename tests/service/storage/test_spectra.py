from __future__ import annotations

import tracemalloc
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
import sqlalchemy

from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.screening import SHARE_OF_STATE, find_lasting
from lbacal_core.spectra.spectra import Spectra
from service.errors import ConflictError
from service.factory import Factory
from service.schema.tables import event
from service.storage.migration import upgrade
from service.storage.spectra import Window
from service.usecases.intake import judge_far
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
    return flat_spectra(*[(f"{name}{k:05d}", 1.4e9 + k / 1000, "CS001", 0, "X") for k in range(events)])


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
    with pytest.raises(ConflictError, match=r"dipole: e41234, CS001 antenna 0 X \(blocks\); what is stored stays"):
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
    with pytest.raises(ConflictError, match=r"e00000, CS001 antenna 0 X \(blocks, power\); .* and 4 more; what is"):
        add(factory, changed)


def of_two_stations(rng: np.random.Generator, minutes: float = 240.0) -> Spectra:
    """Forty events of two stations, some beside each other, with spectra up to 59 s from the first of their event."""
    began = 1.4e9 + np.sort(rng.uniform(0.0, 60.0 * minutes, 40))
    rows = [
        (f"e{k}", float(began[k] + rng.uniform(0.0, 59.0) * (n > 0)), station, antenna, dipole)
        for k in range(40)
        for n, (station, antenna, dipole) in enumerate(product(("CS001", "CS002"), range(3), "XY"))
        if n == 0 or rng.random() < 0.7
    ]
    return flat_spectra(*rows)


def count_rows(factory: Factory, window: Window, least: int) -> tuple[int, bool]:
    """What `content` and `stations_with` say, by a look at every stored spectrum."""
    of_paths: Counter[tuple[Any, ...]] = Counter()
    with factory.database.engine.connect() as connection:
        for row in connection.exec_driver_sql(
            "SELECT station, antenna, dipole, spectrum.time_us, flag, far FROM spectrum "
            "JOIN path ON path.id = path JOIN event ON event.id = event"
        ):
            of_scope = window.scope in (Scope(), Scope(row.station), Scope(row.station, row.antenna, row.dipole))
            if of_scope and window.since <= row.time_us < window.until and row.flag is None and row.far is None:
                of_paths[row[:3]] += 1
    return of_paths.total(), max(of_paths.values(), default=0) >= least


def test_counts_that_are_kept_are_those_of_the_rows(factory: Factory) -> None:
    """Each question of the scheduler about one station walked the spectra of all."""
    rng = np.random.default_rng(11)
    spectra = of_two_stations(rng)
    for _ in range(4):
        some = spectra.select(rng.random(len(spectra)) < 0.4)
        far = np.where(rng.random(len(some)) < 0.1, 30.0, np.nan)
        with factory.database.write() as stores:
            stores.spectra.add(some, far)
    with factory.database.write() as stores:
        assert stores.spectra.add(spectra) > 0
        for name in ("e3", "e17"):
            stores.spectra.set_flag(name, "storm", reason="test", by="test", at=1)
    begin, scopes = round(1.4e15), (Scope(), Scope("CS001"), Scope("CS002"), Scope("CS001", 2, "Y"), Scope("CS003"))
    with factory.database.read() as stores:
        for scope in scopes:
            for minutes in rng.uniform(-10.0, 250.0, (12, 2)):
                first, last = sorted(begin + round(6e7 * m) for m in minutes)
                window, least = Window(first, last, scope), int(rng.integers(1, 30))
                count, is_enough = count_rows(factory, window, least)
                assert stores.spectra.content(window)[0] == count
                if scope.station is not None and scope.antenna is None:
                    held = stores.spectra.contents(first, last)
                    assert held.get(scope.station, (0,))[0] == count
                    assert (scope.station in stores.spectra.stations_with(first, last, least)) == is_enough
        listed = stores.spectra.events()
    assert sum(one.spectra for one in listed) == len(spectra)
    assert all(one.stations in (["CS001"], ["CS001", "CS002"]) for one in listed)


def test_counts_are_right_whoever_sends_what_at_the_same_time(factory: Factory) -> None:
    spectra = of_two_stations(np.random.default_rng(12))

    def send(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(15):
            some = spectra.select(rng.random(len(spectra)) < 0.2)
            with factory.database.write() as stores:
                stores.spectra.add(some, np.where(rng.random(len(some)) < 0.3, 30.0, np.nan))
            with factory.database.write() as stores:
                number, times, _ = next(stores.spectra.waiting(), (0, [], None))
                stores.spectra.end_waiting(number, times[: rng.integers(len(times) + 1)])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(send, range(4)))
    add(factory, spectra)
    with factory.database.engine.connect() as connection:
        kept = "SELECT event, station, spectra, waiting FROM event_station"
        rows = "SELECT event, station, count(*), count(far) FROM spectrum JOIN path ON path.id = path GROUP BY 1, 2"
        found, counted = (sorted(tuple(row) for row in connection.exec_driver_sql(one)) for one in (kept, rows))
    assert found == counted
    assert sum(row[2] for row in found) == len(spectra)
    assert sum(row[3] for row in found) > 0


def test_what_an_older_schema_holds_is_counted_by_the_upgrade(factory: Factory) -> None:
    spectra = of_two_stations(np.random.default_rng(13))
    with factory.database.write() as stores:
        stores.spectra.add(spectra, np.where(np.arange(len(spectra)) % 7 == 0, 30.0, np.nan))
    kept = "SELECT * FROM event_station ORDER BY event, station"
    with factory.database.engine.connect() as connection:
        before = connection.exec_driver_sql(kept).all()
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE event_station")
        connection.exec_driver_sql("DROP INDEX ix_alarm_station_id")
        for name in ("date_us", "sigma_us", "size", "size_sigma", "tilt", "curvature"):
            connection.exec_driver_sql(f"ALTER TABLE change_evidence DROP COLUMN {name}")
        connection.exec_driver_sql("ALTER TABLE promotion DROP COLUMN undoes_us")
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '0027'")
    upgrade(factory.database)
    with factory.database.engine.connect() as connection:
        assert connection.exec_driver_sql(kept).all() == before


def test_covariates_that_are_not_possible_are_not_known_after_an_upgrade(factory: Factory) -> None:
    """Their stations had no fit, and the true temperature of an event was there already."""
    spectra = make_spectra(3, 1)
    add_spectra(factory, spectra)
    wrong = [(1, '{"temperature_c": -999.0, "rain_mm_h": 1.0}'), (2, '{"temperature_c": 283.15}')]
    with factory.database.engine.begin() as connection:
        for number, env in wrong:
            connection.execute(sqlalchemy.update(event).where(event.c.id == number).values(env=env))
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '0032'")
    upgrade(factory.database)
    with factory.database.read() as stores:
        known = [one.env for one in stores.spectra.events()]
    assert known == [{"rain_mm_h": 1.0}, {}, {"temperature_c": 10.0}]
    add_spectra(factory, spectra)
    with factory.database.read() as stores:
        assert [one.env["temperature_c"] for one in stores.spectra.events()] == 3 * [10.0]


@pytest.mark.parametrize(
    "came", [".x" * 40, "x" * 12 + "." * 60, "." * 60 + "x" * 10, "xxxx." * 4 + "." * 50 + "xxxx." * 4]
)
def test_what_waits_is_judged_by_the_ends_of_a_path_as_by_all_of_it(factory: Factory, came: str) -> None:
    """A look read all spectra as soon as one of them waited."""
    is_far = np.array([one == "x" for one in came])
    rows = [(f"e{k}", START + 3600.0 * k, "CS001", antenna, "X") for k in range(len(came)) for antenna in range(2)]
    far = np.where(np.repeat(is_far, 2) & (np.arange(len(rows)) % 2 == 0), 30.0, np.nan)
    spectra = flat_spectra(*rows)
    with factory.database.write() as stores:
        stores.spectra.add(replace(spectra, power=spectra.power * np.nan_to_num(far, nan=1.0)[:, None]), far)
        judged = judge_far(stores)
    assert judged == find_lasting(is_far).sum()
    rng = np.random.default_rng(int(is_far.sum()))
    for _ in range(200):
        size = int(rng.integers(10, 200))
        found = rng.random(size) < rng.random() * np.linspace(1.0, 0.0, size) ** rng.integers(0, 4)
        most = int(found.sum() / SHARE_OF_STATE)
        ends = sorted({*range(min(most, size)), *range(max(size - most, 0), size)})
        whole = find_lasting(found)
        assert np.array_equal(find_lasting(found[ends]), whole[ends])
        assert whole.sum() == whole[ends].sum()


def test_where_no_spectrum_waits_a_look_does_not_read_all(factory: Factory) -> None:
    """With 1.2 million spectra that took a third of a look."""
    add_spectra(factory, flat_spectra(*(("e", START, "CS001", antenna, "X") for antenna in range(3))))
    asked: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        asked.append(statement)

    sqlalchemy.event.listen(sqlalchemy.Engine, "before_cursor_execute", note)
    with factory.database.read() as stores:
        assert list(stores.spectra.waiting()) == []
    sqlalchemy.event.remove(sqlalchemy.Engine, "before_cursor_execute", note)
    assert ["far IS NOT NULL" in one for one in asked if "FROM spectrum" in one] == [True]
