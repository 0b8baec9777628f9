"""Kill -9 of server, worker and scheduler while spectra come in, versions are promoted and refits run.

At the end nothing that was acknowledged is missing, nothing is there twice, and the calibrations in effect are, id by
id, those of a calm run on the same spectra: a version's id is the hash of its inputs, so equal ids mean equal fits.
A trial is twenty kills, in turn, on one database.
"""

from __future__ import annotations

import itertools
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psycopg

from lbacal.bodies import bodies_of_events
from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import write_sky_power
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.settings import TwinSettings
from proofs.machinery.claims import Claim, at_most, claim_rate
from proofs.machinery.parts import Part, Row
from proofs.running.postgres import run_postgres
from proofs.running.processes import Process, find_free_port, is_ready, run_command, running, wait_until
from service.config import Settings
from service.factory import Factory
from service.logs import configure_logs
from service.storage.database import Database
from service.storage.migration import upgrade
from service.usecases.calibrations import select_paths
from service.wire.instants import parse_instant
from service.worker import Worker

CLIENTS = 4
KILLS = 20
QUEUED = 6
DONE = "SELECT job FROM job_part WHERE state = 'done' OR substr(error, 1, 9) = 'no usable'"
UNDONE = "SELECT job FROM job_part WHERE state <> 'done' AND substr(coalesce(error, ''), 1, 9) <> 'no usable'"
DUE_TWICE = "SELECT due_key FROM job WHERE due_key IS NOT NULL GROUP BY due_key HAVING count(*) > 1"
DATES = ("2014-07-01", "2015-07-01")
LARGEST_SHARE = 0.05
"""Share of kills that may break a promise, as far as they can be counted: 0 of 73 shows it."""
SKY = "sky_power.json"
_SETTINGS: dict[str, Any] = {"lease_s": 3, "poll_s": 0.1, "gate_error": 0.5, "gate_change": 0.9, "log_level": "warning"}


@dataclass
class Record:
    """What clients were told."""

    acknowledged: set[str] = field(default_factory=set)
    stored: int = 0
    promotions: set[int] = field(default_factory=set)
    jobs: set[int] = field(default_factory=set)
    answers: Counter[int] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)


def kill_and_compare(kind: str, kills: int, seed: int) -> Row:
    """Run on one kind of database and compare with the calm run."""
    configure_logs("warning")
    with tempfile.TemporaryDirectory(prefix="lbacal-kills-") as name, _database(kind, Path(name)) as url:
        folder = Path(name)
        spectra = _simulate(folder, seed)
        bodies = list(bodies_of_events(spectra))
        calm = _fit_calmly(folder, spectra)
        wild = _run(folder, url, bodies, kills, seed)
    checks = {
        "every acknowledged spectrum is there, once": wild.spectra == len(spectra),
        "no spectrum was reported as stored twice": wild.record.stored <= wild.spectra,
        "every acknowledged promotion is in the ledger": wild.record.promotions <= wild.ledger,
        "every answer was a success, `nothing stored yet` or `unavailable`": set(wild.record.answers)
        <= {200, 201, 202, 409, 503},
        "every acknowledged refit is done": wild.record.jobs <= wild.done,
        "every part of what was due is done, or found its window still empty": wild.undone == 0,
        "every due refit is enqueued once": wild.due_twice == 0,
        "no version was promoted twice in a row": wild.promoted_twice == 0,
        "the calibrations in effect are those of the calm run": wild.in_effect == calm,
    }
    return {
        "kills": kills,
        "broken": [check for check, holds in checks.items() if not holds],
        "spectra": len(spectra),
        "answers": {str(code): count for code, count in sorted(wild.record.answers.items())},
        "promotions": len(wild.record.promotions),
        "refits": len(wild.record.jobs),
        "parts_done": sum(wild.parts.values()),
        "attempts": int(wild.attempts),
        "curves_in_effect": len(wild.in_effect),
    }


def judge(kind: str, rows: Sequence[Row]) -> list[Claim]:
    """How many kills broke a promise; a run with a broken promise counts as one."""
    kills, broken = sum(row["kills"] for row in rows), sum(bool(row["broken"]) for row in rows)
    text = f"A kill -9 of server, worker or scheduler loses, doubles or changes something ({kind})"
    return [claim_rate("broken", text, at_most(LARGEST_SHARE), broken, kills)]


def tell(rows: Sequence[Row]) -> list[str]:
    """What was going on, and every broken promise."""
    lines = []
    for row in rows:
        lines.append(
            f"- {row['kills']} kills; {CLIENTS} clients, {row['spectra']} spectra, sent again and again; answers "
            f"{row['answers']}; {row['promotions']} promotions and {row['refits']} refits acknowledged; "
            f"{row['parts_done']} parts done in {row['attempts']} attempts; {row['curves_in_effect']} curves in effect"
        )
        lines += [f"  NOT SO: {check}" for check in row["broken"]]
    return lines


@contextmanager
def _database(kind: str, folder: Path) -> Iterator[str]:
    """An empty database of a kind."""
    if kind == "sqlite":
        yield str(folder / "kills.sqlite")
        return
    with run_postgres() as server:
        with psycopg.connect(server, autocommit=True) as connection:
            connection.execute("DROP DATABASE IF EXISTS kills")
            connection.execute("CREATE DATABASE kills")
        yield server.replace("/postgres?", "/kills?")


def _simulate(folder: Path, seed: int) -> Spectra:
    """Two years of two antennas, 100 events each."""
    instrument = load_instrument("lofar-superterp")
    sky = compute_sky_power(instrument, lst_hours=np.arange(24.0))
    write_sky_power(sky, folder / SKY)
    settings = TwinSettings(stations=("CS002",), antennas=2, years=1.99, events_per_year=100)
    return simulate_campaign(settings, instrument, sky, np.random.default_rng([20, seed])).spectra


def _fit_calmly(folder: Path, spectra: Spectra) -> dict[tuple[str, ...], str]:
    """The calibrations in effect after one undisturbed night in one process."""
    factory = Factory(Settings(database_url=str(folder / "calm.sqlite"), **_SETTINGS, sky_power=folder / SKY))
    upgrade(factory.database)
    with factory.database.write() as stores:
        stores.spectra.add(spectra)
    factory.due.enqueue()
    Worker(factory).run(threading.Event(), until_idle=True)
    paths = select_paths(factory.instrument, None, None, None)
    found: dict[tuple[str, ...], str] = {}
    for date in DATES:
        for curve in factory.calibrations.in_effect(parse_instant("date", date), paths).curves:
            path = curve.told.curve
            key = (date, str(path.station), str(path.antenna), str(path.dipole))
            found[key] = str(curve.promotion.calibration)
    factory.database.close()
    return found


@dataclass(frozen=True)
class Outcome:
    """What a run left behind."""

    record: Record
    spectra: int
    ledger: set[int]
    parts: Counter[str]
    attempts: int
    done: set[int]
    undone: int
    due_twice: int
    promoted_twice: int
    in_effect: dict[tuple[str, ...], str]


def _run(folder: Path, url: str, bodies: list[dict[str, Any]], kills: int, seed: int) -> Outcome:
    port = find_free_port()
    address = f"http://127.0.0.1:{port}"
    environment = {f"LBACAL_{name.upper()}": str(value) for name, value in _SETTINGS.items()}
    environment |= {"LBACAL_DATABASE_URL": url, "LBACAL_SKY_POWER": str(folder / SKY)}
    run_command(environment, "db", "upgrade")
    key = run_command(environment, "keys", "create", "--scope", "admin").splitlines()[-1]
    log = folder / "log"
    server = Process(environment, log, "serve", "--port", str(port), "--api-only")
    worker, scheduler = Process(environment, log, "worker"), Process(environment, log, "scheduler")
    by_mistake = Process(environment, log, "scheduler")
    record = Record()
    with running(server, worker, scheduler, by_mistake):
        wait_until(lambda: is_ready(address), "the server")
        is_over = threading.Event()
        threads = [
            threading.Thread(target=_send, args=(address, key, bodies, k, record, is_over)) for k in range(CLIENTS)
        ]
        threads.append(threading.Thread(target=_promote, args=(address, key, record, is_over)))
        threads.append(threading.Thread(target=_refit, args=(address, key, record, is_over, seed)))
        for thread in threads:
            thread.start()
        rng = np.random.default_rng([21, seed])
        for victim in itertools.islice(itertools.cycle((server, worker, scheduler)), kills):
            time.sleep(float(rng.uniform(0.2, 2.0)))
            if victim is worker:
                wait_until(lambda: _is_at_work(address), "the worker to be at work")
            victim.kill()
        wait_until(lambda: len(record.acknowledged) == len(bodies), "every event to be acknowledged")
        is_over.set()
        for thread in threads:
            thread.join()
        wait_until(lambda: is_ready(address), "the server")
        run_command(environment, "scheduler", "--once")
        wait_until(lambda: _is_idle(address), "the refits")
        time.sleep(0.5)
        wait_until(lambda: _is_idle(address), "the drift")
        in_effect = _read_in_effect(address)
    return _read_outcome(url, record, in_effect)


def _send(
    address: str, key: str, bodies: list[dict[str, Any]], k: int, record: Record, is_over: threading.Event
) -> None:
    """Send all events again and again, each client from another one on."""
    start = k * len(bodies) // CLIENTS
    with httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=60) as http:
        is_first = True
        while is_first or not is_over.is_set():
            is_first = False
            for body in [*bodies[start:], *bodies[:start]]:
                while not _send_once(http, body, record):
                    time.sleep(0.2)
                if is_over.is_set():
                    return


def _send_once(http: httpx2.Client, body: dict[str, Any], record: Record) -> bool:
    try:
        answer = http.post("/v1/spectra", json=body)
    except httpx2.TransportError:
        return False
    with record.lock:
        record.answers[answer.status_code] += 1
        if answer.is_success:
            record.acknowledged.add(body["spectra"][0]["event_id"])
            record.stored += answer.json()["stored"]
    return bool(answer.is_success)


def _promote(address: str, key: str, record: Record, is_over: threading.Event) -> None:
    """Withdraw the array's calibration of a year long gone, again and again: a promotion that disturbs no refit."""
    year = {"valid_from": "2010-01-01", "valid_to": "2011-01-01"}
    body = {"calibration": None, "scope": "array", **year, "reason": "proof"}
    with httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=60) as http:
        while not is_over.wait(0.1):
            try:
                answer = http.post("/v1/promotions", json=body)
            except httpx2.TransportError:
                continue
            with record.lock:
                record.answers[answer.status_code] += 1
                if answer.is_success:
                    record.promotions.add(answer.json()["promotion"])


def _refit(address: str, key: str, record: Record, is_over: threading.Event, seed: int) -> None:
    """Keep the worker busy with refits of windows of 14 months, so that kills find it at work."""
    rng = np.random.default_rng([22, seed])
    body = {"scope": "antenna", "promote": False, "reason": "proof"}
    with httpx2.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}, timeout=60) as http:
        while not is_over.wait(0.1):
            try:
                jobs = http.get("/v1/jobs", params={"limit": 20}).json()["jobs"]
                if sum(job["state"] in ("queued", "running") for job in jobs) >= QUEUED:
                    continue
                day = int(rng.integers(1, 29))
                window = {"since": f"2014-01-{day:02d}", "until": f"2015-03-{day:02d}"}
                answer = http.post("/v1/refits", json={**body, **window})
            except (httpx2.TransportError, KeyError):
                continue
            with record.lock:
                record.answers[answer.status_code] += 1
                if answer.is_success:
                    record.jobs.add(answer.json()["job"])


def _is_at_work(address: str) -> bool:
    try:
        jobs = httpx2.get(f"{address}/v1/jobs", params={"limit": 20}, timeout=30).json()["jobs"]
    except httpx2.TransportError:
        return False
    return any(job["state"] == "running" for job in jobs)


def _is_idle(address: str) -> bool:
    jobs = httpx2.get(f"{address}/v1/jobs", params={"limit": 1000}, timeout=30).json()["jobs"]
    return all(job["state"] in ("done", "failed") for job in jobs)


def _read_in_effect(address: str) -> dict[tuple[str, ...], str]:
    found: dict[tuple[str, ...], str] = {}
    for date in DATES:
        curves = httpx2.get(f"{address}/v1/calibrations/effective", params={"at": date}, timeout=60).json()["curves"]
        for curve in curves:
            found[(date, curve["station"], str(curve["antenna"]), curve["dipole"])] = curve["calibration"]
    return found


def _read_outcome(url: str, record: Record, in_effect: dict[tuple[str, ...], str]) -> Outcome:
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
                undone=len(rows(UNDONE)),
                due_twice=len(rows(DUE_TWICE)),
                promoted_twice=twice,
                in_effect=in_effect,
            )
    finally:
        database.close()


def _kill(kind: str, seed: int) -> Row:
    return kill_and_compare(kind, KILLS, seed)


PARTS = tuple(
    Part(
        kind, partial(_kill, kind), partial(judge, kind), 5, tell, is_parallel=False,
        code=("lbacal", "lbacal_core", "proofs", "service", "migrations"),
    )
    for kind in ("sqlite", "postgresql")
)  # fmt: skip
