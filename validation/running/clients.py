"""Clients that write, promote, tag and ask for fits all the time, and remember what they were told."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from typing import Any

import httpx2
import numpy as np

from lbacal.instants import format_instant
from lbacal_core.spectra.spectra import Spectra

WRITERS = 4
QUEUED = 6
CHANGED = {"paths": [{"station": "CS002", "antenna": 0, "dipole": "X"}], "at": {"value": "2014-10-01"}}
"""What is entered as a step that a person knows of, in the middle of a year."""
PINNED_AT = "2014-07-01"
"""The date about which a tag is asked when it is made, and again at the end."""


@dataclass
class Record:
    """The answers to clients.

    Attributes
    ----------
    tags
        Name of each acknowledged tag: its instant, and the answer about a path as of then (status and ETag).
    decisions
        The reasons of the decisions about a change that were acknowledged, in their order.
    is_deciding
        Set while the answer to one is waited for.
    """

    acknowledged: set[str] = field(default_factory=set)
    stored: int = 0
    promotions: set[int] = field(default_factory=set)
    jobs: set[int] = field(default_factory=set)
    tags: dict[str, tuple[str, tuple[int, str] | None]] = field(default_factory=dict)
    decisions: list[str] = field(default_factory=list)
    is_deciding: threading.Event = field(default_factory=threading.Event)
    answers: Counter[int] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def has_answers_as_promised(self) -> bool:
        """Whether every answer was a success, `nothing stored yet` or `unavailable`."""
        return set(self.answers) <= {200, 201, 202, 409, 503}

    @property
    def told_answers(self) -> dict[str, int]:
        """How often each status was the answer."""
        return {str(code): count for code, count in sorted(self.answers.items())}


@dataclass
class Clients:
    """Four writers, a promoter, one who tags and one who asks for fits; each repeats what nobody answered.

    With `has_decider` another enters a change, and dismisses it and puts it in force by turns.
    """

    address: str
    key: str
    bodies: Sequence[dict[str, Any]]
    seed: int
    has_decider: bool = False
    record: Record = field(default_factory=Record)
    _is_over: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    def start(self) -> None:
        """Begin."""
        deeds: list[Callable[[httpx2.Client], None]] = [self._promote, self._tag, self._refit]
        deeds += [self._writer(k) for k in range(WRITERS)] + [self._decide] * self.has_decider
        self._threads = [threading.Thread(target=self._work, args=(deed,), daemon=True) for deed in deeds]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End, when what was begun was answered."""
        self._is_over.set()
        for thread in self._threads:
            thread.join()

    def _work(self, deed: Callable[[httpx2.Client], None]) -> None:
        headers = {"Authorization": f"Bearer {self.key}"}
        with httpx2.Client(base_url=self.address, headers=headers, timeout=60) as http:
            deed(http)

    def _note(self, answer: httpx2.Response) -> bool:
        with self.record.lock:
            self.record.answers[answer.status_code] += 1
        return bool(answer.is_success)

    def _writer(self, k: int) -> Callable[[httpx2.Client], None]:
        """Sends all events again and again, beginning at the k-th quarter."""
        start = k * len(self.bodies) // WRITERS
        bodies = [*self.bodies[start:], *self.bodies[:start]]

        def write(http: httpx2.Client) -> None:
            is_first = True
            while is_first or not self._is_over.is_set():
                is_first = False
                for body in bodies:
                    while not self._send(http, body):
                        time.sleep(0.2)
                    if self._is_over.is_set():
                        return

        return write

    def _send(self, http: httpx2.Client, body: dict[str, Any]) -> bool:
        try:
            answer = http.post("/v1/spectra", json=body)
        except httpx2.TransportError:
            return False
        if not self._note(answer):
            return False
        with self.record.lock:
            self.record.acknowledged.add(body["spectra"][0]["event_id"])
            self.record.stored += answer.json()["stored"]
        return True

    def _promote(self, http: httpx2.Client) -> None:
        """Withdraw the array's calibration of a year long gone: a promotion that disturbs no refit."""
        body = {"calibration": None, "scope": "array", "valid_from": "2010-01-01", "valid_to": "2011-01-01"}
        while not self._is_over.wait(0.1):
            try:
                answer = http.post("/v1/promotions", json={**body, "reason": "proof"})
            except httpx2.TransportError:
                continue
            if self._note(answer):
                with self.record.lock:
                    self.record.promotions.add(answer.json()["promotion"])

    def _tag(self, http: httpx2.Client) -> None:
        """Freeze the ledger under one name after the other, and ask what is in effect as of then."""
        number = 0
        while not self._is_over.wait(0.3):
            name = f"t{number}"
            try:
                answer = http.put(f"/v1/tags/{name}", json={"reason": "proof"})
            except httpx2.TransportError:
                number += 1  # it may have been made: this name is left to the past
                continue
            if not self._note(answer):
                continue
            number += 1
            as_of = answer.json()["as_of"]
            with self.record.lock:
                self.record.tags[name] = as_of, ask_pinned(http, as_of)

    def _decide(self, http: httpx2.Client) -> None:
        """Enter a change, then dismiss it and put it in force by turns; dismissed it is left."""
        entered = self._insist(http, "/v1/changes", {**CHANGED, "reason": "proof"}, {"Idempotency-Key": "change"})
        address = f"/v1/changes/{entered.json()['id']}/decision"
        for act, decision in enumerate(cycle(("dismissed", "in_force"))):
            self.record.is_deciding.set()
            self._insist(http, address, {"decision": decision, "reason": f"act {act}"})
            self.record.is_deciding.clear()
            self.record.decisions.append(f"act {act}")
            if self._is_over.wait(0.3) and decision == "dismissed":
                return

    def _insist(
        self, http: httpx2.Client, address: str, body: dict[str, Any], headers: dict[str, str] | None = None
    ) -> httpx2.Response:
        """Repeat what nobody answered; where a conflict is the answer then, it was done."""
        while True:
            try:
                answer = http.post(address, json=body, headers=headers)
            except httpx2.TransportError:
                time.sleep(0.1)
                continue
            if self._note(answer) or answer.status_code == 409:
                return answer
            time.sleep(0.1)

    def _refit(self, http: httpx2.Client) -> None:
        """Keep the worker busy with refits of windows of 14 months, so that kills find it at work."""
        rng = np.random.default_rng([22, self.seed])
        body = {"scope": "antenna", "promote": False, "reason": "proof"}
        while not self._is_over.wait(0.1):
            try:
                jobs = http.get("/v1/jobs", params={"limit": 20}).json()["jobs"]
                if sum(job["state"] in ("queued", "running") for job in jobs) >= QUEUED:
                    continue
                day = int(rng.integers(1, 29))
                window = {"since": f"2014-01-{day:02d}", "until": f"2015-03-{day:02d}"}
                answer = http.post("/v1/refits", json={**body, **window})
            except (httpx2.TransportError, KeyError):
                continue
            if self._note(answer):
                with self.record.lock:
                    self.record.jobs.add(answer.json()["job"])


def ask_pinned(http: httpx2.Client, as_of: str) -> tuple[int, str] | None:
    """Status and ETag of what is in effect on a date as of an instant; None where nobody answers."""
    try:
        answer = http.get("/v1/calibrations/effective", params={"at": PINNED_AT, "as_of": as_of, "station": "CS002"})
    except httpx2.TransportError:
        return None
    return None if answer.status_code >= 500 else (answer.status_code, answer.headers.get("etag", ""))


# What a client without HDF5 sends.


def bodies_of_events(spectra: Spectra) -> Iterator[dict[str, Any]]:
    """The spectra of each event as JSON values, in order of the events' first times."""
    names, of_row = np.unique(spectra.event_id, return_inverse=True)
    first = [spectra.time_unix[of_row == k].min() for k in range(names.size)]
    for event in np.argsort(first, kind="stable").tolist():
        rows = [_describe(spectra, k) for k in np.flatnonzero(of_row == event).tolist()]
        grid = {"frequency_mhz": spectra.frequency_mhz.tolist(), "resistance_ohm": spectra.resistance_ohm}
        yield {**grid, "spectra": rows}


def _describe(spectra: Spectra, k: int) -> dict[str, Any]:
    env = {name: float(values[k]) for name, values in spectra.environment.items() if np.isfinite(values[k])}
    return {
        "event_id": str(spectra.event_id[k]), "time_utc": format_instant(round(float(spectra.time_unix[k]) * 1e6)),
        "station": str(spectra.station[k]), "antenna": int(spectra.antenna[k]), "dipole": str(spectra.dipole[k]),
        "blocks": int(spectra.blocks[k]), "power": spectra.power[k].tolist(), **({"env": env} if env else {}),
    }  # fmt: skip
