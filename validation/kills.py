"""Kill -9 of server, worker, scheduler and PostgreSQL, at random, while clients write, promote, tag and ask for fits.

At the end nothing that was acknowledged is missing, nothing is there twice, a tag answers as it did when it was made,
and the calibrations in effect are those of a calm run on the same spectra: the same versions, or C within the shift
that a night leaves unstored. Nobody lends a hand: what was killed is only started again. A trial is forty kills, and a
proof thirteen trials, 520 kills.

In the parts `-whole` the worker computes on dask, one client more decides about a change again and again, and killed
are also workers of dask, backups while they are written, and the server while it takes a decision. At the end every
decision is there once, and a backup restored elsewhere holds the same.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psycopg

from lbacal.client import Client
from lbacal.instants import parse_instant
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.settings import TwinSettings
from service.cli.opening import configure_logs
from service.config import Settings
from service.storage.database import Database
from service.usecases.calibrations import select_paths
from service.usecases.fits import SMALLEST_SHIFT
from service.worker import Worker
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.running.clients import Clients, Record, ask_pinned, bodies_of_events
from validation.running.ledger import open_factory
from validation.running.postgres import find_binaries, run_server
from validation.running.processes import (
    PYTHON,
    Process,
    Service,
    get,
    is_ready,
    run_cluster,
    run_command,
    run_service,
    wait_until,
    write_coarse_sky,
)

KILLS = 40
CAMPAIGN = TwinSettings(stations=("CS002",), antennas=2, years=1.99, events_per_year=100)
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
SETTINGS: dict[str, Any] = {
    "lease_s": 3,
    "poll_s": 0.1,
    "quiet_s": 0,
    "gate_error": 0.5,
    "gate_change": 0.9,
    "log_level": "warning",
}


@dataclass(frozen=True)
class Told:
    """The curve that a path is served: its version, C and its statistical error, shape (freq,)."""

    version: str
    c: Floats
    sigma: Floats


InEffect = dict[tuple[str, ...], Told]
"""By date, station, antenna and dipole."""


def kill_and_compare(kind: str, kills: int, seed: int, *, is_whole: bool = False) -> Row:
    """Run on one kind of database and compare with the calm run; if whole with dask, backups and decisions."""
    configure_logs("warning")
    with tempfile.TemporaryDirectory(prefix="lbacal-kills-") as name, open_database(kind, Path(name)) as database:
        folder = Path(name)
        spectra, calm = simulate(folder, CAMPAIGN, np.random.default_rng([20, seed])), _fit_calmly(seed)
        bodies, run = list(bodies_of_events(spectra)), _run_whole if is_whole else _run
        record, in_effect, tags, victims = run(folder, database, bodies, kills, seed)
        left = _read_database(database.url)
        restored = _read_database(back_up_and_restore(database.url, folder)) if is_whole else left
    farthest = _find_farthest(in_effect, calm)
    checks = {
        "every decision is there once, in its order": left.decisions == record.decisions,
        "a backup that is restored elsewhere holds the same": restored == left,
        "every acknowledged spectrum is there, once": left.spectra == len(spectra),
        "no spectrum was reported as stored twice": record.stored <= left.spectra,
        "every acknowledged promotion is in the ledger": record.promotions <= left.ledger,
        "every answer was a success, `nothing stored yet` or `unavailable`": record.has_answers_as_promised,
        "every acknowledged tag is there, at its instant": tags[0] == len(record.tags),
        "every tag answers as it did when it was made": tags[1] == 0,
        "every acknowledged refit is done": record.jobs <= left.done,
        "every part of what was due is done, or found its window still empty": not left.undone,
        "every due refit is enqueued once": left.due_twice == 0,
        "no version was promoted twice in a row": left.promoted_twice == 0,
        "the calibrations in effect are those of the calm run, or as near as a night leaves them": farthest
        <= SMALLEST_SHIFT,
    }
    return {
        "kills": kills,
        "victims": dict(sorted(victims.items())),
        "broken": broken_of(checks),
        "spectra": len(spectra),
        "answers": record.told_answers,
        "promotions": len(record.promotions),
        "refits": len(record.jobs),
        "tags": len(record.tags),
        "decisions": len(record.decisions),
        "parts_done": sum(left.parts.values()),
        "attempts": left.attempts,
        "curves_in_effect": len(in_effect),
        "farthest_sigma": round(min(farthest, 1e9), 3),
        **({"undone": left.undone} if left.undone else {}),
    }


def broken_of(checks: Mapping[str, bool]) -> list[str]:
    """The promises that were not kept."""
    return [check for check, holds in checks.items() if not holds]


def judge(rows: Sequence[Row]) -> list[Found]:
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


def simulate(folder: Path, settings: TwinSettings, rng: np.random.Generator, faults: Sequence[Fault] = ()) -> Spectra:
    """Write a sky power of few LST for the service, and simulate a campaign with it."""
    instrument = load_instrument("lofar-superterp")
    return simulate_campaign(settings, instrument, write_coarse_sky(folder / SKY), rng, faults).spectra


@lru_cache(maxsize=1)
def _fit_calmly(seed: int) -> InEffect:
    """The calibrations in effect after one undisturbed night in one process: one night for either kind of database."""
    with tempfile.TemporaryDirectory(prefix="lbacal-calm-") as name:
        return _fit_calmly_in(Path(name), simulate(Path(name), CAMPAIGN, np.random.default_rng([20, seed])))


def _fit_calmly_in(folder: Path, spectra: Spectra) -> InEffect:
    found: InEffect = {}
    with open_factory(str(folder / "calm.sqlite"), **SETTINGS, sky_power=folder / SKY) as factory:
        with factory.database.write() as stores:
            stores.spectra.add(spectra)
        factory.due.enqueue()
        Worker(factory).run(threading.Event(), until_idle=True)
        paths = select_paths(factory.instrument, None, None, None)
        for date in DATES:
            for curve in factory.calibrations.in_effect(parse_instant("date", date), paths).curves:
                path = curve.served.curve
                key = (date, str(path.station), str(path.antenna), str(path.dipole))
                found[key] = Told(str(curve.promotion.calibration), _floats(path.c), _floats(path.c_sigma_stat))
    return found


def _find_farthest(found: InEffect, calm: InEffect) -> float:
    """The largest shift of any path that is told another version; infinite where others are told any."""
    if found.keys() != calm.keys():
        return np.inf
    others = ((one, calm[path]) for path, one in found.items() if one.version != calm[path].version)
    return max((largest_shift((one.c, one.sigma), (other.c, other.sigma)) for one, other in others), default=0.0)


def largest_shift(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> float:
    """The largest difference of C of any channel, in the smaller error; infinite if one alone has a value.

    Parameters
    ----------
    one, other
        C and its statistical error, shape (freq,) each.
    """
    (c, sigma), (other_c, other_sigma) = one, other
    is_known = np.isfinite(c)
    if not np.array_equal(is_known, np.isfinite(other_c)):
        return np.inf
    return float(np.max((np.abs(c - other_c) / np.fmin(sigma, other_sigma))[is_known], initial=0.0))


def _floats(values: Any) -> Floats:
    return np.array([] if values is None else values, dtype=float)


Outcome = tuple[Record, InEffect, tuple[int, int], Counter[str]]
"""What clients were told, what is in effect, what became of tags, and how often each was killed."""


def _run(
    folder: Path,
    database: Killable,
    bodies: list[dict[str, Any]],
    kills: int,
    seed: int,
    computing: Sequence[Process] = (),
    **more: Any,
) -> Outcome:
    # the second scheduler runs by mistake, and nobody kills it
    names = ("worker", "scheduler", "scheduler")
    with run_service(database.url, folder, *names, sky_power=folder / SKY, **SETTINGS, **more) as service:
        address, victims = service.address, victims_of(service, database)
        wait_until(lambda: is_ready(address), "the server")
        clients = Clients(address, service.key, bodies, seed, has_decider=bool(computing))
        record = clients.record
        if computing:
            victims |= _victims_beside(service, database, record, folder)
            victims |= {f"dask {k}": one.kill for k, one in enumerate(computing)}
        clients.start()
        rng = np.random.default_rng([21, seed])
        turns = rng.choice(sorted(victims), kills).tolist()
        for name in turns:
            time.sleep(float(rng.uniform(0.1, 1.5)))
            if name == "worker" or name.startswith("dask"):
                wait_until(lambda: _is_at_work(address), "the worker to be at work")
            victims[name]()
        wait_until(lambda: len(record.acknowledged) == len(bodies), "every event to be acknowledged")
        clients.stop()
        end_the_night(service, lambda: _stays_idle(address))
        return record, _read_in_effect(address), _compare_tags(address, record), Counter(turns)


def _run_whole(folder: Path, database: Killable, bodies: list[dict[str, Any]], kills: int, seed: int) -> Outcome:
    """Run with a cluster of two workers, backups and decisions."""
    with run_cluster(folder, 2) as (address, workers):
        return _run(folder, database, bodies, kills, seed, workers, dask=address)


def victims_of(service: Service, database: Killable) -> dict[str, Callable[[], None]]:
    """How to kill the server, the worker, the scheduler, and the database where it has a server."""
    victims: dict[str, Callable[[], None]] = {process.name: process.kill for process in service.processes[:3]}
    return victims if database.kill is None else victims | {"database": database.kill}


def _victims_beside(
    service: Service, database: Killable, record: Record, folder: Path
) -> dict[str, Callable[[], None]]:
    """How to kill a backup while it is written, and the server while it decides."""
    server, target = service.processes[0], folder / "backup"

    def kill_backup() -> None:
        target.mkdir(exist_ok=True)
        command, silent = backing_up(database.url, target / "killed"), subprocess.DEVNULL
        with subprocess.Popen(command, stdout=silent, stderr=silent) as backup:
            wait_until(lambda: any(target.iterdir()) or backup.poll() is not None, "a backup to be written")
            backup.kill()
        shutil.rmtree(target)

    def kill_decision() -> None:
        wait_until(record.is_deciding.is_set, "a decision to be taken")
        server.kill()

    return {"backup": kill_backup, "decision": kill_decision}


def backing_up(url: str, output: Path) -> list[str]:
    """The command of docs/how-to/keep-the-service.md that copies a database into a file."""
    if "://" not in url:
        # the url reaches the command as a setting, which stands in the place of a word of it
        return ["env", f"LBACAL_DATABASE_URL={url}", *PYTHON, "lbacal", "db", "backup", str(output)]
    return [str((find_binaries() or Path()) / "pg_dump"), "--format=custom", f"--file={output}", url]


def back_up_and_restore(url: str, folder: Path) -> str:
    """Back a database up, and restore it in an empty one; its URL."""
    output = folder / "restored.sqlite"
    subprocess.run(backing_up(url, output), check=True, stdout=subprocess.DEVNULL)
    if "://" not in url:
        return str(output)
    restored = url.replace("/kills?", "/restored?")
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute("CREATE DATABASE restored")
    command = [str((find_binaries() or Path()) / "pg_restore"), "--exit-on-error", "--no-owner", f"--dbname={restored}"]
    subprocess.run([*command, str(output)], check=True)
    return restored


def _is_at_work(address: str) -> bool:
    try:
        jobs = get(f"{address}/v1/jobs", params={"limit": 20}, timeout=30).json()["jobs"]
    except (httpx2.TransportError, KeyError):
        return False  # nobody there, or no database
    return any(job["state"] == "running" for job in jobs)


def end_the_night(service: Service, is_over: Callable[[], bool]) -> None:
    """Enqueue what is due, once the server is there again, and wait for it."""
    wait_until(lambda: is_ready(service.address), "the server")
    run_command(service.environment, "scheduler", "--once")
    wait_until(is_over, "the refits and what follows them")


def is_idle(address: str, kind: str = "") -> bool:
    """Whether every job has ended, and there was one of a kind."""
    jobs = get(f"{address}/v1/jobs", params={"limit": 1000}, timeout=30).json()["jobs"]
    return all(job["state"] in ("done", "failed") for job in jobs) and kind in ["", *(job["kind"] for job in jobs)]


def _stays_idle(address: str) -> bool:
    """Whether nothing is left to do, and no part that ended makes further work."""
    end = time.monotonic() + IDLE_S
    while is_idle(address):
        if time.monotonic() > end:
            return True
        time.sleep(0.2)
    return False


def _read_in_effect(address: str) -> InEffect:
    found: InEffect = {}
    for date in DATES:
        curves = get(f"{address}/v1/calibrations/effective", params={"at": date}, timeout=60).json()["curves"]
        for curve in curves:
            key = (date, curve["station"], str(curve["antenna"]), curve["dipole"])
            found[key] = Told(curve["calibration"], _floats(curve["c"]), _floats(curve["c_sigma_stat"]))
    return found


def _compare_tags(address: str, record: Record) -> tuple[int, int]:
    """How many of the acknowledged tags are there with their instants, and how many give another answer than then."""
    with httpx2.Client(base_url=address, timeout=60) as http, Client(address) as client:
        found = {tag["name"]: tag["as_of"] for tag in client.list("/v1/tags", "tags", limit=1000)}
        kept = sum(found.get(name) == as_of for name, (as_of, _) in record.tags.items())
        changed = sum(then is not None and ask_pinned(http, as_of) != then for as_of, then in record.tags.values())
    return kept, changed


@dataclass(frozen=True)
class Left:
    """The content of the database after a run."""

    spectra: int
    ledger: set[int]
    parts: Counter[str]
    attempts: int
    done: set[int]
    undone: list[str]
    decisions: list[str]
    due_twice: int
    promoted_twice: int


def _read_database(url: str) -> Left:
    """Look into the database behind the service's back."""
    database = Database(Settings(database_url=url).sqlalchemy_url)
    with database.engine.connect() as connection:

        def rows(query: str) -> list[Any]:
            return list(connection.exec_driver_sql(query).all())

        last: dict[Any, Any] = {}
        twice = 0
        for scope, start, calibration in rows(
            "SELECT scope, valid_from_us, calibration FROM promotion ORDER BY at_us, id"
        ):
            twice += calibration is not None and last.get((scope, start)) == calibration
            last[(scope, start)] = calibration
        left = Left(
            spectra=rows("SELECT count(*) FROM spectrum")[0][0],
            ledger={row[0] for row in rows("SELECT id FROM promotion")},
            parts=Counter(row[0] for row in rows("SELECT state FROM job_part")),
            attempts=int(rows("SELECT sum(attempts) FROM job_part")[0][0]),
            done={row[0] for row in rows(DONE)},
            undone=[" ".join(map(str, row)) for row in rows(UNDONE)],
            decisions=[
                row[0] for row in rows("SELECT reason FROM change_decision WHERE reason <> 'proof' ORDER BY id")
            ],
            due_twice=len(rows(DUE_TWICE)),
            promoted_twice=twice,
        )
    database.close()
    return left


PARTS = tuple(
    Part(
        f"{kind}{suffix}",
        partial(kill_and_compare, kind, KILLS, is_whole=bool(suffix)),
        judge,
        count,
        headlines=("broken",) if f"{kind}{suffix}" == "postgresql" else (),
        is_parallel=False,
    )
    for suffix, count in (("", 13), ("-whole", 3))
    for kind in ("sqlite", "postgresql")
)
