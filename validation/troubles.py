"""A full disk, a database that takes no writes, a clock that jumps back an hour: under clients that write and promote.

The server runs as it does for users, in a thread of this process, so that its clock can be set. While the trouble lasts
writes that cannot be done get 503 with the reason, reads go on, and `/readyz` tells what is wrong with the database.
When it is over all goes on without a hand: nothing that was acknowledged is missing, and tags answer as they did.
"""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psycopg
import uvicorn

from lbacal.instants import read_clock
from lbacal_core.curves.validity import Instant
from lbacal_core.instrument.instrument import load_instrument
from service.app import make_app
from service.cli.connections import configure_server, listen
from service.cli.opening import configure_logs
from service.config import Settings
from service.factory import Factory
from service.storage.database import FULL, READ_ONLY
from service.storage.migration import upgrade
from service.storage.processes import WORKER
from service.usecases.status import Pulse
from validation.kills import broken_of
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.running.clients import Clients, Record, ask_pinned
from validation.running.postgres import run_server
from validation.running.processes import is_ready, wait_until, write_coarse_sky

EVENTS, PATHS = 400, 8
ROOM = "64m"
"""Size of the file system that fills."""
BACK_US = 3_600_000_000
AHEAD, AHEAD_STATUS = "ahead of this server's clock", 422
TROUBLES = ("sqlite-full", "postgresql-full", "postgresql-read-only", "sqlite-clock", "postgresql-clock")


@dataclass
class Clock:
    """The clock of the server, and how far it is off, microseconds."""

    off: int = 0

    def __call__(self) -> Instant:
        """Now, as the server sees it."""
        return read_clock() + self.off

    def turn(self, off: int) -> None:
        """Let it be off by some microseconds."""
        self.off = off


@dataclass(frozen=True)
class Trouble:
    """A failure of a database, and the words in which a write that cannot be done is refused meanwhile."""

    url: str
    begin: Callable[[], None]
    end: Callable[[], None]
    words: str


@contextmanager
def small_disk(owner: str | None = None) -> Iterator[Path]:
    """A file system of its own, in memory; PermissionError where we may not mount one."""
    with tempfile.TemporaryDirectory(prefix="lbacal-disk-") as name:
        command = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}", "tmpfs", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise PermissionError(f"a small disk cannot be mounted: {done.stderr.strip()}")
        try:
            if owner is not None:
                user = pwd.getpwnam(owner)
                os.chown(name, user.pw_uid, user.pw_gid)
            yield Path(name)
        finally:
            subprocess.run(["umount", "--lazy", name], check=True)  # noqa: S607


def fill(disk: Path) -> None:
    with (disk / "balloon").open("wb") as balloon:
        while (free := shutil.disk_usage(disk).free) > 0:
            with suppress(OSError):  # somebody else took some of it: look again
                os.posix_fallocate(balloon.fileno(), os.fstat(balloon.fileno()).st_size, free)


def filled(url: str, disk: Path) -> Trouble:
    return Trouble(url, partial(fill, disk), (disk / "balloon").unlink, FULL)


@contextmanager
def prepare(name: str, clock: Clock) -> Iterator[Trouble]:
    """An empty database, and a trouble that can be made for it."""
    kind, _, what = name.partition("-")
    turned = partial(Trouble, begin=partial(clock.turn, -BACK_US), end=partial(clock.turn, 0), words=AHEAD)
    if kind == "sqlite":
        with small_disk() if what == "full" else tempfile.TemporaryDirectory() as folder:
            disk = Path(folder)
            url = str(disk / "lbacal.sqlite")
            yield filled(url, disk) if what == "full" else turned(url)
        return
    with run_server() as server, psycopg.connect(server.url, autocommit=True) as connection:
        url = server.url.replace("/postgres?", "/troubles?")
        if what == "full":
            with small_disk(server.folder.owner()) as disk:
                place = disk / "tables"
                place.mkdir()
                shutil.chown(place, server.folder.owner())
                connection.execute(f"CREATE TABLESPACE small LOCATION '{place}'")
                connection.execute("CREATE DATABASE troubles TABLESPACE small")
                yield filled(url, disk)
            return
        connection.execute("CREATE DATABASE troubles")

        def set_read_only(value: str) -> None:
            connection.execute(f"ALTER SYSTEM SET default_transaction_read_only = {value}")
            connection.execute("SELECT pg_reload_conf()")

        read_only = Trouble(url, partial(set_read_only, "on"), partial(set_read_only, "off"), READ_ONLY)
        yield turned(url) if what == "clock" else read_only


def make_bodies(events: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    mhz = load_instrument("lofar-superterp").frequency_mhz
    return [
        {
            "frequency_mhz": mhz.tolist(),
            "spectra": [
                {
                    "event_id": f"e{event}", "time_utc": f"2014-{1 + event % 12:02d}-{1 + event % 28:02d}T00:00:00Z",
                    "station": "CS002", "antenna": path // 2, "dipole": "XY"[path % 2], "blocks": 100,
                    "power": rng.lognormal(-6.0, 1.0, mhz.size).tolist(),
                }
                for path in range(PATHS)
            ],
        }
        for event in range(events)
    ]  # fmt: skip


def endure(name: str, events: int, seed: int) -> Row:
    """Make a trouble while clients work, end it, and compare what they were told with what is there."""
    configure_logs("critical")
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder, prepare(name, clock) as trouble:
        sky = Path(folder) / "sky_power.json"
        write_coarse_sky(sky)
        factory = Factory(Settings(database_url=trouble.url, sky_power=sky, max_rate=1e5), clock)
        upgrade(factory.database)
        _, key = factory.keys.create(("admin",))
        with Pulse(factory.database, WORKER), serving(factory) as address:
            clients = Clients(address, key, make_bodies(events, np.random.default_rng([23, seed])), seed)
            return _run(factory, trouble, clients)


@contextmanager
def serving(factory: Factory) -> Iterator[str]:
    listening = listen("127.0.0.1", 0)
    server = uvicorn.Server(configure_server(make_app(factory), 100))
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()
        factory.database.close()


def _run(factory: Factory, trouble: Trouble, clients: Clients) -> Row:
    record, address = clients.record, clients.address
    is_clock = trouble.words == AHEAD
    wait_until(lambda: is_ready(address), "the server")
    clients.start()
    events = len(clients.bodies)
    wait_until(lambda: len(record.acknowledged) >= events // 8 and bool(record.tags), "the clients to be at work")
    trouble.begin()
    with httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {clients.key}"}, timeout=60) as http:
        said: list[str] = []
        deed = promote if is_clock else partial(send_another, clients.bodies[0])
        wait_until(lambda: _is_refused(deed(http), trouble.words, said), f"a refusal with the words: {trouble.words}")
        before = record.answers[503]
        wait_until(lambda: record.answers[503] > before, "a client to be refused")
        read, alive = http.get("/v1/events?limit=1"), http.get("/healthz")
        # on PostgreSQL small writes find room in pages that are there: readiness tells how the last write went
        wait_until(lambda: is_clock or _is_refused(http.get("/readyz"), trouble.words, said), "readiness to tell why")
        time.sleep(0.5)
        trouble.end()
        wait_until(lambda: is_ready(address), "the server to be ready again")
        wait_until(lambda: len(record.acknowledged) == events, "every event to be acknowledged")
        promoted = len(record.promotions)
        wait_until(lambda: len(record.promotions) > promoted, "promotions to go on")
        clients.stop()
        # a tag made while the clock is back names an instant ahead of it, which could not be asked about then
        asked = [(as_of, then) for as_of, then in record.tags.values() if then is not None and then[0] != AHEAD_STATUS]
        changed = sum(ask_pinned(http, as_of) != then for as_of, then in asked)
    lost, is_ordered = _compare(factory, record)
    checks = {
        "reads went on": (read.status_code, alive.status_code) == (200, 200),
        "every answer was a success, `nothing stored yet` or `unavailable`": record.has_answers_as_promised,
        "every tag answers as it did when it was made": changed == 0,
        "promotions have instants that rise": is_ordered,
        "the file is whole": _is_whole(factory),
    }
    return {
        "acknowledged": len(record.acknowledged) + len(record.promotions) + len(record.tags),
        "lost": lost,
        "broken": broken_of(checks),
        "answers": record.told_answers,
        "said": said[-1],
    }


def promote(http: httpx2.Client) -> httpx2.Response:
    body = {"calibration": None, "scope": "array", "valid_from": "2010-01-01", "valid_to": "2011-01-01"}
    return http.post("/v1/promotions", json={**body, "reason": "proof"})


def send_another(body: dict[str, Any], http: httpx2.Client) -> httpx2.Response:
    name = f"another at {time.time_ns()}"
    return http.post("/v1/spectra", json={**body, "spectra": [{**one, "event_id": name} for one in body["spectra"]]})


def _is_refused(answer: httpx2.Response, words: str, said: list[str]) -> bool:
    """Whether a request was refused with the words; what can still be done is."""
    if answer.status_code != 503:
        return False
    said.append(answer.json()["detail"])
    return words in said[-1] and "retry-after" in answer.headers


def _compare(factory: Factory, record: Record) -> tuple[int, bool]:
    """How many acknowledged events, promotions and tags are missing, and whether promotions rise in time."""
    with factory.database.engine.connect() as connection:

        def rows(query: str) -> list[Any]:
            return list(connection.exec_driver_sql(query).all())

        counted = "SELECT event_id FROM event JOIN spectrum ON event = id GROUP BY event_id HAVING count(*) = "
        whole = {row[0] for row in rows(f"{counted}{PATHS}")}
        ledger = rows("SELECT id, at_us FROM promotion ORDER BY id")
        tags = {row[0] for row in rows("SELECT name FROM tag")}
    numbers, instants = {row[0] for row in ledger}, [row[1] for row in ledger]
    lost = len(record.acknowledged - whole) + len(record.promotions - numbers) + len(record.tags.keys() - tags)
    return lost, instants == sorted(set(instants))


def _is_whole(factory: Factory) -> bool:
    with factory.database.engine.connect() as connection:
        is_sqlite = factory.settings.is_sqlite
        return not is_sqlite or bool(connection.exec_driver_sql("PRAGMA integrity_check").scalar_one() == "ok")


def judge(rows: Sequence[Row]) -> list[Found]:
    lost = sum(row["lost"] + bool(row["broken"]) for row in rows)
    return [rate_of("lost", lost, sum(row["acknowledged"] for row in rows))]


PARTS = tuple(Part(name, partial(endure, name, EVENTS), judge, 10, is_parallel=False) for name in TROUBLES)
