"""Two simulated years through the service, over HTTP, as a user would run it.

A server is started on SQLite, spectra are sent, the scheduler finds what is due, and the calibration in effect is asked
for before and after the gain step that was planted in one path.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.client import Client
from lbacal.transport import UnreachableError
from lbacal_core.errors import name_path
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from validation.running.processes import find_free_port, make_key, run_command

STATION, ANTENNA, DIPOLE = "CS002", 5, "Y"
STEP = GainStep(size=0.12, date="2015-04-11", where=Where(antennas=(ANTENNA,), dipoles=(DIPOLE,)))
BEFORE, AFTER = "2015-02-15", "2015-06-15"
NIGHT = ("refit", "drift", "watch")
"""Jobs after which the night has found the step and refitted the windows that it cuts."""


@dataclass(frozen=True)
class ServedRun:
    """The answers of the service: C in effect on two dates, and the drift of the station and of the path."""

    url: str
    curves: dict[str, dict[str, Any]]
    station: dict[str, Any]
    path: dict[str, Any]

    @property
    def step(self) -> dict[str, Any]:
        """The first of the ranking."""
        found: dict[str, Any] = self.station["steps"][0]
        return found

    @property
    def is_found(self) -> bool:
        """Whether that is the step that was planted, within a month, and C is another one behind it."""
        is_path = (self.step["antenna"], self.step["dipole"]) == (ANTENNA, DIPOLE)
        days = abs(np.datetime64(self.step["date"]) - np.datetime64(STEP.date)) / np.timedelta64(1, "D")
        before, after = (self.curves[at]["valid"] for at in (BEFORE, AFTER))
        return bool(is_path and days <= 31 and before["to"] <= after["from"])


@dataclass(frozen=True)
class Server:
    """A service that runs, where it answers, and the environment of commands that belong to it."""

    url: str
    environment: dict[str, str]
    process: subprocess.Popen[bytes]
    log: Path

    def wait(self, is_so: Callable[[], bool]) -> None:
        """Wait until something is so; a server that has ended will not make it so."""
        while not is_so():
            if self.process.poll() is not None:
                raise RuntimeError(f"the server has ended: {self.log} says why")
            time.sleep(0.1)


@contextmanager
def running_server(folder: Path, *, searches: bool) -> Iterator[Server]:
    """Run the service in a folder of its own until the block ends; yields the server.

    `searches` is whether its nights ask what the simulation gets wrong: that is half of their time.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    port = find_free_port()
    settings = {
        "DATABASE_URL": str(folder / "lbacal.sqlite"), "POLL_S": "0.2", "STALE_DAYS": "0",  # the years are long ago
        "NIGHTLY_INVESTIGATIONS": str(searches).lower(),
    }  # fmt: skip
    environment = os.environ | {f"LBACAL_{name}": value for name, value in settings.items()}
    serve = [sys.executable, "-m", "validation.demo.service_run", "serve", "--port", str(port)]
    with (folder / "log").open("wb") as log:
        server = subprocess.Popen(serve, env=environment, stdin=subprocess.PIPE, stdout=log, stderr=log)
    try:
        yield Server(f"http://127.0.0.1:{port}", environment, server, folder / "log")
    finally:
        server.terminate()
        server.wait()


def serve_years(spectra: Spectra, server: Server, tell: Callable[[str], None]) -> ServedRun:
    """Send two years, wait for the night's work, and ask what is in effect before and after the step."""
    url = server.url
    with Client(url) as client:
        server.wait(lambda: _answers(client))
    key = make_key(server.environment["LBACAL_DATABASE_URL"], "spectra:write")
    with Client(url, key) as client:
        total = client.ingest(spectra)
        tell(f"lbacal serve: {url}; lbacal ingest: {total['stored']} spectra of two years stored")
        tell(f"lbacal scheduler: {run_command(server.environment, 'scheduler', '--once').strip()}")
        server.wait(lambda: _is_done(client))
        jobs = client.get("/v1/jobs")["jobs"]
        tell(f"lbacal worker: {sum(len(job['calibrations']) for job in jobs)} calibrations made")
        path: dict[str, Any] = {"station": STATION, "antenna": ANTENNA, "dipole": DIPOLE}
        curves = {at: client.get("/v1/calibrations/effective", at=at, **path)["curves"][0] for at in (BEFORE, AFTER)}
        drift = client.get("/v1/drift", station=STATION), client.get("/v1/drift", **path)
        return ServedRun(url, curves, *drift)


def describe_served(run: ServedRun) -> str:
    step, planted = run.step, (1.0 + STEP.size) ** -0.5 - 1.0
    path = name_path(step["station"], step["antenna"], step["dipole"])
    return (
        f"The daily run found that C of {path} changed by {100 * step['size']:+.2f} ± {100 * step['sigma']:.2f} % on "
        f"{step['date']}; planted was {100 * planted:+.2f} % in antenna {ANTENNA} {DIPOLE} on {STEP.date}."
    )


def _answers(client: Client) -> bool:
    try:
        client.get("/healthz")
    except UnreachableError:
        return False
    return True


def _is_done(client: Client) -> bool:
    """Whether the refits have ended, the drift of both years, the watch over it, and the refits of what it cut."""
    jobs = [job for job in client.get("/v1/jobs")["jobs"] if job["kind"] in NIGHT]
    if not any(job["kind"] == "watch" for job in jobs) or any(job["state"] in ("queued", "running") for job in jobs):
        return False
    changes: list[dict[str, Any]] = client.get("/v1/changes")["changes"]
    return all(one["refitted"] for one in changes)


def end_with_parent() -> None:
    """Ask this process to end when its standard input does: whoever started it has gone, in whatever way."""
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    from lbacal.cli.main import main

    threading.Thread(target=end_with_parent, daemon=True).start()
    main()
