"""Spectra in one table and in one by year: .venv/bin/python -m validation.benchmarks.partitions [STATIONS [EVENTS]].

Two databases of one PostgreSQL hold ten years of some stations of 96 paths, and the same questions are put to both in
turn. In one the table `spectrum` is partitioned by the year of its time, which then belongs to its key. The statements
are those of the service: those of a window name its times, so that PostgreSQL looks into the partitions of these years
alone. Times are processor time of the server and of who asks, the mean of some turns (a backup has one: it reads all).
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import psycopg

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.spectra.spectra import Spectra
from service.cli.opening import configure_logs
from service.factory import Factory
from service.storage.database import Database
from service.storage.spectra import Window
from service.usecases.drift import start_of_year
from validation.running.ledger import open_factory
from validation.running.postgres import find_binaries, open_databases

FIRST, YEARS = 2014, 10
ANTENNAS = 48
TURNS = 8
BACKUP = "backup of all"
TICKS = os.sysconf("SC_CLK_TCK")
MHZ = load_instrument("lofar-superterp").frequency_mhz
INSIDE = FIRST + YEARS // 2
FILL = """
INSERT INTO path (station, antenna, dipole)
SELECT 'S' || station, antenna, dipole
FROM generate_series(1, %(stations)s::int) AS station, generate_series(1, %(antennas)s::int) AS antenna,
    unnest(ARRAY['X', 'Y']) AS dipole ORDER BY 1, 2, 3;
INSERT INTO event (event_id, time_us)
SELECT year || '-' || k, year_us + (k + 0.5) * 31536000000000 / %(events)s::int
FROM unnest(%(years)s::bigint[]) WITH ORDINALITY AS y (year_us, year), generate_series(0, %(events)s::int - 1) AS k
ORDER BY 2;
INSERT INTO spectrum (path, event, time_us, blocks, power)
SELECT path.id, event.id, time_us, 100, %(power)s::bytea FROM event, path ORDER BY event.id, path.id;
INSERT INTO event_station (event, station, spectra, waiting)
SELECT event.id, station, 2 * %(antennas)s::int, 0 FROM event, (SELECT DISTINCT station FROM path) AS s ORDER BY 1, 2
"""


def part_by_year(connection: psycopg.Connection) -> None:
    """Partition the empty table of spectra by the year of their time, which becomes a part of its key."""
    connection.execute("ALTER TABLE spectrum RENAME TO whole")
    connection.execute(
        "CREATE TABLE spectrum (LIKE whole INCLUDING DEFAULTS, PRIMARY KEY (event, path, time_us), "
        "FOREIGN KEY (path) REFERENCES path (id), FOREIGN KEY (event) REFERENCES event (id)) "
        "PARTITION BY RANGE (time_us)"
    )
    connection.execute("DROP TABLE whole")
    connection.execute("CREATE INDEX ON spectrum (path) WHERE far IS NOT NULL")
    for year in range(FIRST, FIRST + YEARS):
        since, until = start_of_year(year), start_of_year(year + 1)
        years = f"FOR VALUES FROM ({since}) TO ({until})"
        connection.execute(f"CREATE TABLE spectrum_{year} PARTITION OF spectrum {years}".encode())


def fill(url: str, stations: int, events: int) -> None:
    """Fill a database: every event of every year has all paths."""
    years = [start_of_year(year) for year in range(FIRST, FIRST + YEARS)]
    values = {
        "stations": stations,
        "antennas": ANTENNAS,
        "events": events,
        "years": years,
        "power": np.ones(MHZ.size).tobytes(),
    }
    with psycopg.connect(url, autocommit=True, cursor_factory=psycopg.ClientCursor) as connection:
        connection.execute(FILL, values)
        connection.execute("VACUUM ANALYZE")


def event_of(station: str | None, stations: int, number: int) -> Spectra:
    """One more event, of a station or of all."""
    names = [station] if station else [f"S{k}" for k in range(1, stations + 1)]
    paths = [(name, antenna, dipole) for name in names for antenna in range(1, ANTENNAS + 1) for dipole in "XY"]
    rows, time = len(paths), parse_instant("", f"{INSIDE}-07-01") / 1e6 + 60.0 * number
    return Spectra(
        MHZ, np.ones((rows, MHZ.size)), np.full(rows, f"new {number} {station}"), np.full(rows, time),
        *(np.array(column) for column in zip(*paths, strict=True)), np.full(rows, 100),
    )  # fmt: skip


def load(database: Database, scope: Scope) -> Spectra | None:
    window = Window(start_of_year(INSIDE), start_of_year(INSIDE + 1), scope)
    with database.read() as stores:
        return stores.spectra.load(window, MHZ, 50.0)


def questions(url: str, factory: Factory, stations: int, folder: Path) -> dict[str, Callable[[int], object]]:
    """The questions by name; each takes the number of the turn."""
    database = factory.database

    def count(_: int) -> None:
        with database.read() as stores:
            stores.spectra.content(Window(start_of_year(INSIDE), start_of_year(INSIDE + 1), Scope("S1")))
            stores.spectra.stations_with(start_of_year(INSIDE), start_of_year(INSIDE + 1), 60)
            stores.spectra.newest_by_path()

    def add(station: str | None, turn: int) -> None:
        with database.write() as stores:
            stores.spectra.add(event_of(station, stations, turn))

    def dump(_: int, *more: str) -> None:
        program = str((find_binaries() or Path()) / "pg_dump")
        subprocess.run([program, "--format=custom", f"--file={folder / 'dump'}", *more, url], check=True)

    def vacuum(_: int) -> None:
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute("VACUUM ANALYZE spectrum")

    return {
        "a station's year read": lambda _: load(database, Scope("S1")),
        "a path's year read": lambda _: load(database, Scope("S1", 1, "X")),
        "an event of a station stored": partial(add, "S1"),
        "an event of all stations stored": partial(add, None),
        "counts of a look": count,
        "vacuum after an event": vacuum,
        BACKUP: dump,
    }


def compare(stations: int, events: int) -> Iterator[tuple[str, float, float]]:
    """Each question, its seconds in one piece, and by year."""
    with (
        open_databases("postgresql", "whole", "parted") as (whole, parted),
        open_factory(whole) as one,
        open_factory(parted) as other,
        tempfile.TemporaryDirectory() as folder,
    ):
        with psycopg.connect(parted, autocommit=True) as connection:
            part_by_year(connection)
        asked = []
        for url, factory in ((whole, one), (parted, other)):
            fill(url, stations, events)
            asked.append(questions(url, factory, stations, Path(folder)))
        with psycopg.connect(whole, autocommit=True) as connection:
            ((folder_of_server,),) = connection.execute("SHOW data_directory").fetchall()
        server = int((Path(folder_of_server) / "postmaster.pid").read_text().split()[0])
        for name in asked[0]:
            warm, turns = (0, 1) if name == BACKUP else (1, TURNS)
            yield name, *_time_both([one[name] for one in asked], server, warm, turns)


def _time_both(both: Sequence[Callable[[int], object]], server: int, warm: int, turns: int) -> tuple[float, float]:
    """Mean processor time of each, s, after some turns that warm up."""
    spent = np.zeros((warm + turns, 2))
    for turn in range(warm + turns):
        for k, ask in enumerate(both):
            begin = _used(server)
            ask(turn)
            spent[turn, k] = _used(server) - begin
    whole, parted = spent[warm:].mean(axis=0).tolist()
    return whole, parted


def _used(server: int) -> float:
    """Processor time of a server and of this process, each with all processes that it started, s."""
    ours = sum(os.times()[:4])
    started = Path(f"/proc/{server}/task/{server}/children").read_text(encoding="ascii").split()
    for process in (server, *map(int, started)):
        try:
            fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue  # it has ended, and counts among those that ended
        ours += sum(map(int, fields[11:15])) / TICKS
    return ours


def main(stations: int = 6, events: int = 100) -> None:
    configure_logs("warning")
    print(
        f"{stations} stations, {YEARS} years of {events} events: {stations * YEARS * events * 2 * ANTENNAS:,} spectra"
    )
    for name, whole, parted in compare(stations, events):
        ratio = parted / whole
        print(f"  {name}: {1e3 * whole:.1f} ms in one table, {1e3 * parted:.1f} ms by year: {ratio:.2f}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
