"""The second half of `./dev demo`: two simulated years of a station through the running service, over HTTP.

A server is started on SQLite as a user would start it, spectra are sent, the scheduler finds what is due, the
calibration in effect on a date is asked for, and the drift shows the gain step that was planted.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
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
from lbacal_core.in_words import name_path
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import TwinSettings

STATION = "CS002"
SETTINGS = TwinSettings(stations=(STATION,), antennas=8, years=1.99, events_per_year=300)
STEP = GainStep(size=0.12, date="2015-04-11", where=Where(antennas=(7,), dipoles=("Y",)))
ANTENNA, DIPOLE = 7, "Y"
ASKED = {"station": STATION, "antenna": ANTENNA, "dipole": DIPOLE, "at": "2015-06-15"}
SEED = 2015
PATIENCE_S = 180.0


@dataclass(frozen=True)
class ServedRun:
    """What the service answered: the curve in effect on a date, and the drift of the station and of the path."""

    url: str
    curve: dict[str, Any]
    station: dict[str, Any]
    path: dict[str, Any]

    @property
    def step(self) -> dict[str, Any]:
        """The first of the ranking."""
        found: dict[str, Any] = self.station["steps"][0]
        return found

    @property
    def is_found(self) -> bool:
        """Whether that is the step that was planted, within a month."""
        is_path = (self.step["antenna"], self.step["dipole"]) == (ANTENNA, DIPOLE)
        days = abs(np.datetime64(self.step["date"]) - np.datetime64(STEP.date)) / np.timedelta64(1, "D")
        return bool(is_path and days <= 31)


@contextmanager
def serve_demonstration(
    instrument: Instrument, sky_power: SkyPower, folder: Path, tell: Callable[[str], None]
) -> Iterator[ServedRun]:
    """Run the service in a folder of its own until the block ends."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    environment = os.environ | {"LBACAL_DATABASE_URL": str(folder / "lbacal.sqlite"), "LBACAL_POLL_S": "0.2"}
    environment["LBACAL_STALE_DAYS"] = "0"  # the simulated years are long ago
    command = [sys.executable, "-m", "lbacal"]
    serve = [sys.executable, "-m", "service.cli.demo_service", "serve", "--port", str(port)]
    with (folder / "log").open("wb") as log:
        server = subprocess.Popen(serve, env=environment, stdin=subprocess.PIPE, stdout=log, stderr=log)
    try:
        spectra = simulate_campaign(SETTINGS, instrument, sky_power, np.random.default_rng(SEED), [STEP]).spectra
        with Client(url) as client:
            _wait(lambda: _answers(client), f"the server, which logs to {folder / 'log'}")
        tell(f"lbacal serve: {url}, SQLite in {folder}")
        made = _run([*command, "keys", "create", "--scope", "spectra:write", "--scope", "refits:run"], environment)
        with Client(url, made.splitlines()[-1]) as client:
            total = client.ingest(spectra)
            tell(f"lbacal ingest: {total['stored']} spectra of {len(np.unique(spectra.event_id))} events in two years")
            tell(f"lbacal scheduler: {_run([*command, 'scheduler', '--once'], environment).strip()}")
            _wait(lambda: _is_done(client), "the refits")
            jobs = client.get("/v1/jobs")["jobs"]
            made_versions = sum(len(job["calibrations"]) for job in jobs)
            promoted = sum(len(job["promoted"]) for job in jobs)
            tell(f"worker: {len(jobs)} jobs done, {made_versions} versions made, {promoted} passed the gate")
            yield ServedRun(
                url=url,
                curve=client.get("/v1/calibrations/effective", **ASKED)["curves"][0],
                station=client.get("/v1/drift", station=STATION),
                path=client.get("/v1/drift", **{k: ASKED[k] for k in ("station", "antenna", "dipole")}),
            )
    finally:
        server.terminate()
        server.wait()


def describe_served(run: ServedRun) -> str:
    """What the service found, in two sentences."""
    valid, step = run.curve["valid"], run.step
    planted = (1.0 + STEP.size) ** -0.5 - 1.0
    path = name_path(step["station"], step["antenna"], step["dipole"])
    return (
        f"In effect for {name_path(STATION, ANTENNA, DIPOLE)} on {ASKED['at']}: version "
        f"{run.curve['calibration'][:12]}, of scope {run.curve['answered_by']}, valid from {valid['from'][:10]} to "
        f"{valid['to'][:10]}. The largest step of C is that of {path} on {step['date']}: {100 * step['size']:+.2f} ± "
        f"{100 * step['sigma']:.2f} %; planted was {100 * planted:+.2f} % in antenna {ANTENNA} {DIPOLE} "
        f"on {STEP.date}."
    )


def _run(command: list[str], environment: dict[str, str]) -> str:
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[2:])} failed: {done.stderr}")
    return done.stdout


def _wait(is_so: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {PATIENCE_S:g} s for {what}")
        time.sleep(0.1)


def _answers(client: Client) -> bool:
    try:
        client.get("/readyz")
    except UnreachableError:
        return False
    return True


def _is_done(client: Client) -> bool:
    """Whether every refit has ended, the drift of both years that follows from them, and the watch over it."""
    jobs = client.get("/v1/jobs")["jobs"]
    years = sum(job["kind"] == "drift" for job in jobs)
    is_watched = any(job["kind"] == "watch" for job in jobs)
    return years >= 2 and is_watched and all(job["state"] in ("done", "failed") for job in jobs)


def end_with_parent() -> None:
    """Ask this process to end when its standard input does: whoever started it has gone, in whatever way."""
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    from lbacal.cli.main import main

    threading.Thread(target=end_with_parent, daemon=True).start()
    main()
