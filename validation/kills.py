"""Kill -9 of server, worker, scheduler and PostgreSQL, at random, while clients write, promote, tag and ask for fits.

At the end nothing that was acknowledged is missing, nothing is there twice, a tag answers as it did when it was made,
and the calibrations in effect are those of a calm run on the same spectra: the same versions, or C within the shift
that a night leaves unstored. Nobody lends a hand: what was killed is only started again. A trial is forty kills, and a
proof thirteen trials, 520 kills.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psycopg

from lbacal.instants import parse_instant
from lbacal.transport import bodies_of_events
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.config import Settings
from service.factory import Factory
from service.logs import configure_logs
from service.storage.database import Database
from service.storage.migration import upgrade
from service.usecases.calibrations import select_paths
from service.usecases.fits import SMALLEST_SHIFT
from service.worker import Worker
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.running.clients import Clients, Record, ask_pinned
from validation.running.postgres import run_server
from validation.running.processes import Process, find_free_port, is_ready, run_command, running, wait_until

KILLS = 40
DONE = "SELECT job FROM job_part WHERE state = 'done' OR substr(error, 1, 9) = 'no usable'"
UNDONE = (
    "SELECT kind, job_part.request, state, attempts, error FROM job_part JOIN job ON job.id = job_part.job "
    "WHERE state <> 'done' AND substr(coalesce(error, ''), 1, 9) <> 'no usable'"
)
DUE_TWICE = "SELECT due_key FROM job WHERE due_key IS NOT NULL GROUP BY due_key HAVING count(*) > 1"
DATES = ("2014-07-01", "2015-07-01")
IDLE_S = 3.0
"""What a part enqueues when it ends is there within this time: the drift of new versions, and the watch over it."""
SKY = "sky_power.json"
_SETTINGS: dict[str, Any] = {"lease_s": 3, "poll_s": 0.1, "gate_error": 0.5, "gate_change": 0.9, "log_level": "warning"}


@dataclass(frozen=True)
class Told:
    """What a path is told: by which version, C and its statistical error, shape (freq,)."""

    version: str
    c: Floats
    sigma: Floats


InEffect = dict[tuple[str, ...], Told]
"""By date, station, antenna and dipole."""


def kill_and_compare(kind: str, kills: int, seed: int) -> Row:
    """Run on one kind of database and compare with the calm run."""
    configure_logs("warning")
    with tempfile.TemporaryDirectory(prefix="lbacal-kills-") as name, open_database(kind, Path(name)) as database:
        folder = Path(name)
        spectra = _simulate(folder, seed)
        bodies = list(bodies_of_events(spectra))
        calm = _fit_calmly(folder, spectra)
        wild = _run(folder, database, bodies, kills, seed)
    checks = {
        "every acknowledged spectrum is there, once": wild.spectra == len(spectra),
        "no spectrum was reported as stored twice": wild.record.stored <= wild.spectra,
        "every acknowledged promotion is in the ledger": wild.record.promotions <= wild.ledger,
        "every answer was a success, `nothing stored yet` or `unavailable`": set(wild.record.answers)
        <= {200, 201, 202, 409, 503},
        "every acknowledged tag is there, at its instant": wild.tags_kept == len(wild.record.tags),
        "every tag answers as it did when it was made": wild.tags_changed == 0,
        "every acknowledged refit is done": wild.record.jobs <= wild.done,
        "every part of what was due is done, or found its window still empty": not wild.undone,
        "every due refit is enqueued once": wild.due_twice == 0,
        "no version was promoted twice in a row": wild.promoted_twice == 0,
        "the calibrations in effect are those of the calm run, or as near as a night leaves them": _are_alike(
            wild.in_effect, calm
        ),
    }
    return {
        "kills": kills,
        "victims": dict(sorted(wild.victims.items())),
        "broken": [check for check, holds in checks.items() if not holds],
        "spectra": len(spectra),
        "answers": {str(code): count for code, count in sorted(wild.record.answers.items())},
        "promotions": len(wild.record.promotions),
        "refits": len(wild.record.jobs),
        "tags": len(wild.record.tags),
        "parts_done": sum(wild.parts.values()),
        "attempts": int(wild.attempts),
        "curves_in_effect": len(wild.in_effect),
        **({"undone": wild.undone} if wild.undone else {}),
    }


def judge(rows: Sequence[Row]) -> list[Found]:
    """How many kills broke a promise; a run with a broken promise counts as one."""
    return [rate_of("broken", sum(bool(row["broken"]) for row in rows), sum(row["kills"] for row in rows))]


@dataclass(frozen=True)
class Killable:
    """An empty database, and how to kill its server, if it has one."""

    url: str
    kill: Callable[[], None] | None = None


@contextmanager
def open_database(kind: str, folder: Path) -> Iterator[Killable]:
    """An empty database of a kind."""
    if kind == "sqlite":
        yield Killable(str(folder / "kills.sqlite"))
        return
    with run_server() as server:
        with psycopg.connect(server.url, autocommit=True) as connection:
            connection.execute("CREATE DATABASE kills")
        yield Killable(server.url.replace("/postgres?", "/kills?"), server.kill)


def _simulate(folder: Path, seed: int) -> Spectra:
    """Two years of two antennas, 100 events each."""
    instrument = load_instrument("lofar-superterp")
    sky = compute_sky_power(instrument, lst_hours=np.arange(24.0))
    write_sky_power(sky, folder / SKY)
    settings = TwinSettings(stations=("CS002",), antennas=2, years=1.99, events_per_year=100)
    return simulate_campaign(settings, instrument, sky, np.random.default_rng([20, seed])).spectra


def _fit_calmly(folder: Path, spectra: Spectra) -> InEffect:
    """The calibrations in effect after one undisturbed night in one process."""
    factory = Factory(Settings(database_url=str(folder / "calm.sqlite"), **_SETTINGS, sky_power=folder / SKY))
    upgrade(factory.database)
    with factory.database.write() as stores:
        stores.spectra.add(spectra)
    factory.due.enqueue()
    Worker(factory).run(threading.Event(), until_idle=True)
    paths = select_paths(factory.instrument, None, None, None)
    found: InEffect = {}
    for date in DATES:
        for curve in factory.calibrations.in_effect(parse_instant("date", date), paths).curves:
            path = curve.told.curve
            key = (date, str(path.station), str(path.antenna), str(path.dipole))
            found[key] = Told(str(curve.promotion.calibration), _floats(path.c), _floats(path.c_sigma_stat))
    factory.database.close()
    return found


def _are_alike(found: InEffect, calm: InEffect) -> bool:
    """Whether the same paths are told the same versions, or C that differs by what a night does not store."""
    return found.keys() == calm.keys() and all(
        one.version == calm[path].version or _largest_shift(one, calm[path]) <= SMALLEST_SHIFT
        for path, one in found.items()
    )


def _largest_shift(one: Told, other: Told) -> float:
    """The largest difference of any channel in the smaller statistical error; infinite if one alone has a value."""
    is_known = np.isfinite(one.c)
    if not np.array_equal(is_known, np.isfinite(other.c)):
        return np.inf
    shift = np.abs(one.c - other.c) / np.fmin(one.sigma, other.sigma)
    return float(np.max(shift[is_known], initial=0.0))


def _floats(values: Any) -> Floats:
    return np.array([] if values is None else values, dtype=float)


@dataclass(frozen=True)
class Outcome:
    """What a run left behind."""

    record: Record
    spectra: int
    ledger: set[int]
    parts: Counter[str]
    attempts: int
    done: set[int]
    undone: list[str]
    due_twice: int
    promoted_twice: int
    in_effect: InEffect
    tags_kept: int
    tags_changed: int
    victims: Counter[str]


def _run(folder: Path, database: Killable, bodies: list[dict[str, Any]], kills: int, seed: int) -> Outcome:
    port = find_free_port()
    address = f"http://127.0.0.1:{port}"
    environment = {f"LBACAL_{name.upper()}": str(value) for name, value in _SETTINGS.items()}
    environment |= {"LBACAL_DATABASE_URL": database.url, "LBACAL_SKY_POWER": str(folder / SKY)}
    run_command(environment, "db", "upgrade")
    key = run_command(environment, "keys", "create", "--scope", "admin").splitlines()[-1]
    log = folder / "log"
    processes = [
        Process(environment, log, "serve", "--port", str(port), "--api-only"),
        Process(environment, log, "worker"),
        Process(environment, log, "scheduler"),
    ]
    by_mistake = Process(environment, log, "scheduler")
    victims: dict[str, Callable[[], None]] = {process.name: process.kill for process in processes}
    if database.kill is not None:
        victims["database"] = database.kill
    killed: Counter[str] = Counter()
    with running(*processes, by_mistake):
        wait_until(lambda: is_ready(address), "the server")
        clients = Clients(address, key, bodies, seed)
        clients.start()
        rng = np.random.default_rng([21, seed])
        for name in rng.choice(sorted(victims), kills):
            time.sleep(float(rng.uniform(0.1, 1.5)))
            if name == "worker":
                wait_until(lambda: _is_at_work(address), "the worker to be at work")
            victims[str(name)]()
            killed[str(name)] += 1
        record = clients.record
        wait_until(lambda: len(record.acknowledged) == len(bodies), "every event to be acknowledged")
        clients.stop()
        wait_until(lambda: is_ready(address), "the server")
        run_command(environment, "scheduler", "--once")
        wait_until(lambda: _stays_idle(address), "the refits and the drift")
        in_effect, kept, changed = _read_in_effect(address), *_compare_tags(address, record)
    return _read_outcome(database.url, record, in_effect, kept, changed, killed)


def _is_at_work(address: str) -> bool:
    try:
        jobs = httpx2.get(f"{address}/v1/jobs", params={"limit": 20}, timeout=30).json()["jobs"]
    except (httpx2.TransportError, KeyError):
        return False  # nobody there, or no database
    return any(job["state"] == "running" for job in jobs)


def _is_idle(address: str) -> bool:
    jobs = httpx2.get(f"{address}/v1/jobs", params={"limit": 1000}, timeout=30).json()["jobs"]
    return all(job["state"] in ("done", "failed") for job in jobs)


def _stays_idle(address: str) -> bool:
    """Whether nothing is left to do, and no part that ended makes further work."""
    end = time.monotonic() + IDLE_S
    while _is_idle(address):
        if time.monotonic() > end:
            return True
        time.sleep(0.2)
    return False


def _read_in_effect(address: str) -> InEffect:
    found: InEffect = {}
    for date in DATES:
        curves = httpx2.get(f"{address}/v1/calibrations/effective", params={"at": date}, timeout=60).json()["curves"]
        for curve in curves:
            key = (date, curve["station"], str(curve["antenna"]), curve["dipole"])
            found[key] = Told(curve["calibration"], _floats(curve["c"]), _floats(curve["c_sigma_stat"]))
    return found


def _compare_tags(address: str, record: Record) -> tuple[int, int]:
    """How many of the acknowledged tags are there with their instants, and how many give another answer than then."""
    with httpx2.Client(base_url=address, timeout=60) as http:
        found: dict[str, str] = {}
        cursor: Any = None
        while True:
            more = {} if cursor is None else {"cursor": cursor}
            page = http.get("/v1/tags", params={"limit": 1000, **more}).json()
            found |= {tag["name"]: tag["as_of"] for tag in page["tags"]}
            cursor = page.get("next")
            if cursor is None:
                break
        kept = sum(found.get(name) == as_of for name, (as_of, _) in record.tags.items())
        changed = sum(then is not None and ask_pinned(http, as_of) != then for as_of, then in record.tags.values())
    return kept, changed


def _read_outcome(
    url: str, record: Record, in_effect: InEffect, tags_kept: int, tags_changed: int, victims: Counter[str]
) -> Outcome:
    """Look into the database behind the service's back."""
    database = Database(Settings(database_url=url).sqlalchemy_url)
    try:
        with database.engine.connect() as connection:

            def rows(query: str) -> list[Any]:
                return list(connection.exec_driver_sql(query).all())

            promotions = rows("SELECT scope, valid_from_us, calibration FROM promotion ORDER BY at_us, id")
            last: dict[Any, Any] = {}
            twice = 0
            for scope, start, calibration in promotions:
                twice += calibration is not None and last.get((scope, start)) == calibration
                last[(scope, start)] = calibration
            return Outcome(
                record=record,
                spectra=rows("SELECT count(*) FROM spectrum")[0][0],
                ledger={row[0] for row in rows("SELECT id FROM promotion")},
                parts=Counter(row[0] for row in rows("SELECT state FROM job_part")),
                attempts=rows("SELECT sum(attempts) FROM job_part")[0][0],
                done={row[0] for row in rows(DONE)},
                undone=[" ".join(map(str, row)) for row in rows(UNDONE)],
                due_twice=len(rows(DUE_TWICE)),
                promoted_twice=twice,
                in_effect=in_effect,
                tags_kept=tags_kept,
                tags_changed=tags_changed,
                victims=victims,
            )
    finally:
        database.close()


PARTS = tuple(
    Part(kind, partial(kill_and_compare, kind, KILLS), judge, 13, headlines=("broken",), is_parallel=False)
    for kind in ("sqlite", "postgresql")
)
