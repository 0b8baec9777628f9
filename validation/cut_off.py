"""A dask cluster in two network namespaces: one is cut off in the middle of its work, and its worker killed later.

The scheduler of dask, the worker of the service and one worker of dask are in the first, another worker of dask in the
second. When that one is at work the link goes down, so that nobody is told anything any more, and nobody is told either
that the worker dies. The night ends all the same: every part is begun once, and versions, promotions and numbers are
those of the night of one process. Namespaces are made by `ip`, which wants to be root.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.settings import TwinSettings
from service.cli.opening import configure_logs
from service.worker import Worker
from validation.kills import SETTINGS, SKY, broken_of, simulate
from validation.machinery.claims import Found, exactly
from validation.machinery.parts import Part, Row
from validation.machinery.run import RefusedError
from validation.running.ledger import open_factory
from validation.running.postgres import open_databases
from validation.running.processes import PYTHON, wait_until

CAMPAIGN = TwinSettings(stations=("CS002", "CS003"), antennas=2, years=0.99, events_per_year=120)
LATEST = 3
"""The link goes down at the first piece of work over there, or at one of the next two."""
LONGEST_S = 45.0
"""The worker that is cut off dies within so long; 30 s after the cut TCP gives its connection up."""
NUMBERS = ("c", "c_sigma_stat", "c_sigma_sys")
PORT = 8786
PRELOADED = """
import time
from pathlib import Path

from service.usecases import fits

begun, signs, work = [], Path("{signs}"), fits._do_at

def do_at(*of):
    begun.append(of)
    (signs / f"{name} {{len(begun)}}").touch()
    while len(begun) >= {at} and not (signs / "cut").exists():
        time.sleep(0.01)
    return work(*of)

def dask_setup(worker):
    fits._do_at = do_at
    (signs / "{name} 0").touch()
"""
"""What a worker does at every piece of work: it says so, and from one on it waits until the link is down."""


@dataclass
class Namespace:
    """A network of its own, joined to another by a cable."""

    name: str
    address: str
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, log: Path, *command: str, **environment: str) -> subprocess.Popen[bytes]:
        """Start a program of Python there, as the leader of a group of processes."""
        program = ["ip", "netns", "exec", self.name, *PYTHON, *command]
        with log.open("ab") as told:
            self._running.append(
                subprocess.Popen(
                    program, env=os.environ | environment, stdout=told, stderr=told, start_new_session=True
                )
            )
        return self._running[-1]

    def kill(self) -> None:
        """Kill all that runs there, as a power cut would (signal 9)."""
        for one in self._running:
            if one.poll() is None:
                os.killpg(one.pid, signal.SIGKILL)
                one.wait()


def ip(*words: str) -> None:
    command = ["ip", *words]
    subprocess.run(command, check=True, capture_output=True)


@contextmanager
def two_networks() -> Iterator[tuple[Namespace, Namespace]]:
    """Two namespaces and a cable between them, which are gone after the block with all that runs there.

    Raises RefusedError where they cannot be made.
    """
    if os.geteuid() != 0 or shutil.which("ip") is None:
        raise RefusedError("a network namespace is made by root with the command ip: nothing was done")
    number = os.getpid()
    pair = [Namespace(f"lbacal-{end}-{number}", f"10.213.0.{k}") for k, end in enumerate("ab", 1)]
    with ExitStack() as cleaning:
        for one in pair:
            try:
                ip("netns", "add", one.name)
            except subprocess.CalledProcessError as error:
                raise RefusedError(f"this machine makes no network namespace: {error.stderr.decode()}") from error
            cleaning.callback(ip, "netns", "del", one.name)
            cleaning.callback(one.kill)
        first, second = pair
        ip("link", "add", "cable", "netns", first.name, "type", "veth", "peer", "name", "cable", "netns", second.name)
        for one in pair:
            ip("-n", one.name, "address", "add", f"{one.address}/24", "dev", "cable")
            for device in ("lo", "cable"):
                ip("-n", one.name, "link", "set", device, "up")
        yield first, second


def compare(kind: str, seed: int) -> Row:
    """Run the night in two networks, and in this process, on one kind of database."""
    configure_logs("warning")
    rng = np.random.default_rng([25, seed])
    with (
        two_networks() as networks,
        tempfile.TemporaryDirectory(prefix="lbacal-cut-off-") as name,
        open_databases(kind, "cut", "plain") as (cut, plain),
    ):
        folder = Path(name)
        spectra = simulate(folder, CAMPAIGN, rng)
        at, kill_s = int(rng.integers(1, LATEST + 1)), float(rng.uniform(0.0, LONGEST_S))
        begin = time.monotonic()
        left = _run(cut, folder, spectra, lambda: _cut_and_kill(networks, folder, cut, at, kill_s))
        seconds_of_night = round(time.monotonic() - begin, 1)
        alone = _run(plain, folder, spectra, lambda: None)
    checks = {
        "every part is done, and was begun once": set(left["parts"]) == {("done", 1)},
        "there are the versions of the plain night, each once": left["versions"].keys() == alone["versions"].keys(),
        "there are the promotions of the plain night, each once": left["promotions"] == alone["promotions"],
    }
    found = {"broken": broken_of(checks), "differs": _differ(left["versions"], alone["versions"])}
    told = {"cut_at": at, "killed_after_s": round(kill_s, 1), "night_s": seconds_of_night}
    return {**found, **told, "versions": len(left["versions"]), "parts": len(left["parts"])}


def _run(url: str, folder: Path, spectra: Spectra, work: Callable[[], None]) -> dict[str, Any]:
    """What a night left: its parts are done by a work, and what that leaves in this process."""
    with open_factory(url, **SETTINGS, sky_power=folder / SKY, nightly_investigations=False) as factory:
        with factory.database.write() as stores:
            stores.spectra.add(spectra)
        factory.due.enqueue()
        work()
        Worker(factory).run(threading.Event(), until_idle=True)
        with factory.database.engine.connect() as connection:

            def ask(words: str) -> list[Any]:
                return [tuple(row) for row in connection.exec_driver_sql(words)]

            return {
                "versions": dict(ask("SELECT id, curves FROM calibration")),
                "promotions": ask("SELECT scope, calibration FROM promotion ORDER BY scope, calibration"),
                "parts": ask("SELECT state, attempts FROM job_part"),
            }


def _cut_and_kill(networks: Sequence[Namespace], folder: Path, url: str, at: int, kill_s: float) -> None:
    """Do the parts in two networks, one of which is cut off at the n-th piece of its work."""
    here, there = networks
    signs, log = folder / "signs", folder / "log"
    signs.mkdir()
    settings = {**SETTINGS, "database_url": url, "sky_power": folder / SKY, "nightly_investigations": False}
    address = f"tcp://{here.address}:{PORT}"
    environment = {f"LBACAL_{name.upper()}": str(value) for name, value in settings.items()}
    here.start(log, "dask", "scheduler", "--host", here.address, "--no-dashboard")
    for one, first in ((here, 1), (there, at)):
        preloaded = folder / f"{one.name}.py"
        preloaded.write_text(PRELOADED.format(signs=signs, name=one.name, at=first))
        more = ("--local-directory", str(folder), "--no-dashboard", "--preload", str(preloaded))
        one.start(log, "dask", "worker", address, "--nthreads", "1", *more, **environment)
        wait_until((signs / f"{one.name} 0").exists, "a worker of dask")
    worker = here.start(log, "lbacal", "worker", "--until-idle", **environment, LBACAL_DASK=address)
    wait_until((signs / f"{there.name} {at}").exists, "the second worker to be at work")
    ip("-n", there.name, "link", "set", "cable", "down")
    (signs / "cut").touch()
    time.sleep(kill_s)
    there.kill()
    if worker.wait(timeout=300) != 0:
        raise RuntimeError(f"the worker of the service failed: {log.read_text()[-2000:]}")


def _differ(found: dict[str, str], expected: dict[str, str]) -> float:
    """The largest relative difference of the numbers of any version."""
    worst = 0.0
    for name in found.keys() & expected.keys():
        for one, other in zip(json.loads(found[name]), json.loads(expected[name]), strict=True):
            for key in NUMBERS:
                mine, theirs = (np.array(curve[key] or [], dtype=float) for curve in (one, other))
                worst = max(worst, float(np.nanmax(np.abs(mine / theirs - 1.0), initial=0.0)))
    return worst


def judge(rows: Sequence[Row]) -> list[Found]:
    return [
        exactly("broken", sum(bool(row["broken"]) for row in rows), "", len(rows)),
        exactly("differs", max(row["differs"] for row in rows), "", len(rows)),
    ]


PARTS = tuple(
    Part(kind, partial(compare, kind), judge, 3, headlines=shown, is_parallel=False)
    for kind, shown in (("sqlite", ()), ("postgresql", ("broken",)))
)
