"""Kill -9 of server, worker and scheduler while spectra come in, versions are promoted and refits run.

At the end nothing that was acknowledged is missing, nothing is there twice, and the calibrations in effect are, id by
id, those of a calm run on the same spectra: a version's id is the hash of its inputs, so equal ids mean equal fits.
`./dev prove kills sqlite` or `./dev prove kills postgresql`; a second argument is the number of kills.
"""

from __future__ import annotations

import itertools
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psycopg

from lbacal.client import bodies_of_events
from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import write_sky_power
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.settings import TwinSettings
from proofs._postgres import run_postgres
from proofs._processes import Process, find_free_port, is_ready, run_command, running, wait_until
from service.config import Settings
from service.storage.database import Database

CLIENTS = 4
KILLS = 20
DATES = ("2014-07-01", "2015-07-01")
SEED = 20


@dataclass
class Record:
    """What clients were told."""

    acknowledged: set[str] = field(default_factory=set)
    stored: int = 0
    promotions: set[int] = field(default_factory=set)
    answers: Counter[int] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Run on one kind of database and compare with the calm run."""
    kind = arguments[0] if arguments else "sqlite"
    kills = int(arguments[1]) if len(arguments) > 1 else KILLS
    with tempfile.TemporaryDirectory(prefix="lbacal-kills-") as name, _databases(kind, Path(name)) as urls:
        folder = Path(name)
        spectra = _simulate(folder)
        bodies = list(bodies_of_events(spectra))
        calm = _run(folder, urls[0], bodies, kills=0)
        wild = _run(folder, urls[1], bodies, kills=kills)
    checks = {
        "every acknowledged spectrum is there, once": wild.spectra == calm.spectra == len(spectra),
        "no spectrum was reported as stored twice": wild.record.stored <= wild.spectra,
        "every acknowledged promotion is in the ledger": wild.record.promotions <= wild.ledger,
        "every answer was a success or `unavailable`": set(wild.record.answers) <= {200, 201, 503},
        "every part is done": set(wild.parts) == {"done"} and set(calm.parts) == {"done"},
        "every due refit is enqueued once": wild.due_twice == 0,
        "no version was promoted twice in a row": wild.promoted_twice == 0,
        "the calibrations in effect are those of the calm run": wild.in_effect == calm.in_effect,
    }
    told = dict(sorted(wild.record.answers.items()))
    done = f"{sum(wild.parts.values())} parts done in {wild.attempts} attempts (calm: {sum(calm.parts.values())})"
    figures = [
        f"- {kind}: {kills} kills (server, worker, scheduler in turn); {CLIENTS} clients, {len(bodies)} events,",
        f"  {len(spectra)} spectra, sent again and again; two schedulers, one of them by mistake.",
        f"- answers {told}; {len(wild.record.promotions)} promotions acknowledged; {done}.",
        f"- {len(wild.in_effect)} curves in effect, compared with the calm run by id.",
        *[f"- {'yes' if holds else 'NO'}: {claim}" for claim, holds in checks.items()],
    ]
    return all(checks.values()), figures


@contextmanager
def _databases(kind: str, folder: Path) -> Iterator[tuple[str, str]]:
    """Two empty databases of a kind."""
    if kind == "sqlite":
        yield str(folder / "calm.sqlite"), str(folder / "wild.sqlite")
        return
    with run_postgres() as server:
        with psycopg.connect(server, autocommit=True) as connection:
            for name in ("kills_calm", "kills_wild"):
                connection.execute(f"DROP DATABASE IF EXISTS {name}".encode())
                connection.execute(f"CREATE DATABASE {name}".encode())
        yield server.replace("/postgres?", "/kills_calm?"), server.replace("/postgres?", "/kills_wild?")


def _simulate(folder: Path) -> Spectra:
    """Two years of two antennas, 100 events each."""
    instrument = load_instrument("lofar-superterp")
    sky = compute_sky_power(instrument, lst_hours=np.arange(24.0))
    write_sky_power(sky, folder / "sky_power.json")
    settings = TwinSettings(stations=("CS002",), antennas=2, years=1.99, events_per_year=100)
    return simulate_campaign(settings, instrument, sky, np.random.default_rng(SEED)).spectra


@dataclass(frozen=True)
class Outcome:
    """What a run left behind."""

    record: Record
    spectra: int
    ledger: set[int]
    parts: Counter[str]
    attempts: int
    due_twice: int
    promoted_twice: int
    in_effect: dict[tuple[str, ...], str]


def _run(folder: Path, url: str, bodies: list[dict[str, Any]], kills: int) -> Outcome:
    port = find_free_port()
    address = f"http://127.0.0.1:{port}"
    environment = {
        "LBACAL_DATABASE_URL": url, "LBACAL_SKY_POWER": str(folder / "sky_power.json"), "LBACAL_LEASE_S": "3",
        "LBACAL_POLL_S": "0.1", "LBACAL_GATE_ERROR": "0.5", "LBACAL_GATE_CHANGE": "0.9", "LBACAL_LOG_LEVEL": "warning",
    }  # fmt: skip
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
        clients = [
            threading.Thread(target=_send, args=(address, key, bodies, k, record, is_over)) for k in range(CLIENTS)
        ]
        promoter = threading.Thread(target=_promote, args=(address, key, record, is_over))
        for thread in (*clients, promoter):
            thread.start()
        rng = np.random.default_rng(SEED)
        for victim in itertools.islice(itertools.cycle((server, worker, scheduler)), kills):
            time.sleep(float(rng.uniform(0.2, 2.0)))
            victim.kill()
        wait_until(lambda: len(record.acknowledged) == len(bodies), "every event to be acknowledged")
        is_over.set()
        for thread in (*clients, promoter):
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
    body = {"calibration": None, "valid_from": "2010-01-01", "valid_to": "2011-01-01", "reason": "proof"}
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


def _is_idle(address: str) -> bool:
    jobs = httpx2.get(f"{address}/v1/jobs", params={"limit": 1000}, timeout=30).json()["jobs"]
    return all(job["state"] in ("done", "failed") for job in jobs)


def _read_in_effect(address: str) -> dict[tuple[str, ...], str]:
    found = {}
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
                due_twice=len(rows("SELECT due_key FROM job GROUP BY due_key HAVING count(*) > 1")),
                promoted_twice=twice,
                in_effect=in_effect,
            )
    finally:
        database.close()
