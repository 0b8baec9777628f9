"""Kill -9 of server, worker, scheduler and PostgreSQL while a cause is adopted and withdrawn, again and again.

A station whose clock is two hours behind was investigated. One client adopts the finding and withdraws it under
idempotency keys, repeating what nobody answered; others ask for investigations. At the end every adoption is there
once with all its refits, no version is there twice, and after the last withdrawal the calibrations in effect are those
from before the first adoption, bit by bit.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings
from service.config import Settings
from service.storage.database import Database
from service.storage.migration import upgrade
from validation.kills import (
    SETTINGS,
    SKY,
    Killable,
    broken_of,
    end_the_night,
    is_idle,
    judge,
    open_database,
    simulate,
    victims_of,
)
from validation.machinery.parts import Part, Row
from validation.running.processes import get, is_ready, post, run_service, wait_until

KILLS = 20
CAMPAIGN = TwinSettings(stations=("CS002",), antennas=2, years=0.99, events_per_year=120)
FAULT = LstOffset(size=2.0)
WINDOW = {"since": "2014-01-01", "until": "2015-01-01", "reason": "proof"}
ASKED = {"station": "CS002", "at": "2014-07-01"}
ACTS = "SELECT act, count(*) FROM model_change GROUP BY act"
REFITS = "SELECT reason, count(*) FROM job WHERE kind = 'refit' AND substr(reason, 1, 4) = 'act ' GROUP BY reason"
UNDONE = "SELECT id FROM job_part WHERE state <> 'done'"
REFITS_OF_AN_ACT = 3
"""One year of the scopes antenna, station and array."""


@dataclass
class Adopter:
    """Adopts and withdraws in turn; every act has an idempotency key and is repeated until it is answered."""

    address: str
    key: str
    investigation: str
    acts: int = 0
    jobs: set[int] = field(default_factory=set)
    answers: Counter[int] = field(default_factory=Counter)
    model: str = ""
    _is_over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Work until told to stop, and end with a withdrawal."""
        headers = {"Authorization": f"Bearer {self.key}"}
        with httpx2.Client(base_url=self.address, headers=headers, timeout=90) as http:
            while not self._is_over.is_set():
                body = {"finding": 0, "promote": True}
                self.model = self._act(http, f"/v1/investigations/{self.investigation}/adoption", body)["model"]
                self._act(http, f"/v1/models/{self.model}/withdrawal", {})

    def stop(self) -> None:
        """End after the withdrawal."""
        self._is_over.set()

    def _act(self, http: httpx2.Client, path: str, body: dict[str, Any]) -> Any:
        self.acts += 1
        name = f"act {self.acts}"
        while True:
            try:
                answer = http.post(path, json={**body, "reason": name}, headers={"Idempotency-Key": name})
            except httpx2.TransportError:
                time.sleep(0.1)
                continue
            self.answers[answer.status_code] += 1
            if answer.is_success:
                self.jobs |= set(answer.json()["jobs"])
                return answer.json()
            if answer.status_code != 503:
                raise RuntimeError(f"{path}: {answer.status_code} {answer.text}")
            time.sleep(0.1)


def kill_and_count(kind: str, kills: int, seed: int) -> Row:
    """Run on one kind of database, and count what is there afterwards."""
    with tempfile.TemporaryDirectory(prefix="lbacal-adoptions-") as name, open_database(kind, Path(name)) as database:
        return _run(Path(name), database, kills, seed)


def _run(folder: Path, database: Killable, kills: int, seed: int) -> Row:
    spectra = simulate(folder, CAMPAIGN, np.random.default_rng([23, seed]), [FAULT])
    store = Database(Settings(database_url=database.url).sqlalchemy_url)
    upgrade(store)
    with store.write() as stores:
        stores.spectra.add(spectra)
    rng = np.random.default_rng([24, seed])
    with run_service(database.url, folder, "worker", "scheduler", sky_power=folder / SKY, **SETTINGS) as service:
        address, key, victims = service.address, service.key, victims_of(service, database)
        wait_until(lambda: is_ready(address), "the server")
        wait_until(lambda: is_idle(address, "investigation"), "the night")
        (found,) = get(f"{address}/v1/investigations").json()["investigations"]
        before = _read_in_effect(address)
        adopter = Adopter(address, key, found["id"])
        thread = threading.Thread(target=adopter.run, daemon=True)
        thread.start()
        turns = [sorted(victims)[k % len(victims)] for k in range(kills)]
        for victim in turns:
            time.sleep(float(rng.uniform(0.3, 2.0)))
            victims[victim]()
            _ask_for_investigation(address, key)
        adopter.stop()
        wait_until(lambda: not thread.is_alive(), "the last withdrawal")
        end_the_night(service, lambda: is_idle(address, "refit"))
        after = _read_in_effect(address)
    row = _count(store, adopter, is_restored=before == after)
    store.close()
    return {**row, "kills": kills, "victims": dict(Counter(turns))}


def _count(store: Database, adopter: Adopter, *, is_restored: bool) -> Row:
    with store.connect() as connection:
        acts = {act: int(count) for act, count in connection.exec_driver_sql(ACTS).all()}
        refits = {reason: int(count) for reason, count in connection.exec_driver_sql(REFITS).all()}
        undone = len(connection.exec_driver_sql(UNDONE).all())
    checks = {
        "every adoption and every withdrawal is there once": acts
        == {"adopted": adopter.acts // 2, "withdrawn": adopter.acts // 2},
        "each has its refits, all or none": set(refits.values()) == {REFITS_OF_AN_ACT} and len(refits) == adopter.acts,
        "every part is done": undone == 0,
        "after the last withdrawal the old numbers are in effect, bit by bit": is_restored,
    }
    return {
        "acts": adopter.acts,
        "answers": {str(code): count for code, count in sorted(adopter.answers.items())},
        "broken": broken_of(checks),
    }


def _ask_for_investigation(address: str, key: str) -> None:
    """Ask, and be content with no answer: the process that would give it may be dead."""
    with suppress(httpx2.TransportError):
        post(f"{address}/v1/investigations", json=WINDOW, headers={"Authorization": f"Bearer {key}"}, timeout=5)


def _read_in_effect(address: str) -> Any:
    """What every path of the station is told, or that nothing is in effect."""
    answer = get(f"{address}/v1/calibrations/effective", params=ASKED, timeout=60)
    return [(c["calibration"], c["c"], c["c_sigma_stat"]) for c in answer.json().get("curves", [])]


PARTS = tuple(
    Part(kind, partial(kill_and_count, kind, KILLS), judge, 1, headlines=shown, is_parallel=False)
    for kind, shown in (("sqlite", ()), ("postgresql", ("broken",)))
)
