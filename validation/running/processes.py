"""Processes of the service for proofs and tests: started as a user would, ended by a signal or killed."""

from __future__ import annotations

import os
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower, write_sky_power
from validation.running.ledger import open_factory

PATIENCE_S = 120.0
PYTHON = (sys.executable, "-m")
"""In front of the name of a program: the one that is installed here."""
CERTIFICATES = ssl.create_default_context()
"""Read once: each request by itself would do so again, which takes four times as long as its answer."""
get, post = partial(httpx2.get, verify=CERTIFICATES), partial(httpx2.post, verify=CERTIFICATES)


def find_free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def wait_until(is_so: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {PATIENCE_S:g} s for {what}")
        time.sleep(0.05)


def is_ready(url: str, page: str = "readyz") -> bool:
    """Whether a server answers and has its database; by the page `healthz`, whether it answers."""
    try:
        return bool(get(f"{url}/{page}", timeout=5).is_success)
    except httpx2.TransportError:
        return False


def run_command(environment: Mapping[str, str], *arguments: str) -> str:
    """Run a command of `lbacal` to its end and return what it printed."""
    command = [*PYTHON, "lbacal", *arguments]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"lbacal {' '.join(arguments)} failed: {done.stderr}")
    return done.stdout


class Process:
    """A command of `lbacal`, or of another program, that runs until it is stopped; killed, it can be started anew."""

    def __init__(self, environment: Mapping[str, str], log: Path, *arguments: str, program: str = "lbacal") -> None:
        self.name = arguments[0]
        self._command = [*PYTHON, program, *arguments]
        self._environment = os.environ | environment
        self.log = log
        self._running = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        with self.log.open("ab") as log:
            return subprocess.Popen(self._command, env=self._environment, stdout=log, stderr=log)

    @property
    def number(self) -> int:
        """The number of the process that runs now."""
        return self._running.pid

    def kill(self) -> None:
        """Kill it as a power cut would (signal 9), and start it anew."""
        self._running.kill()
        self._running.wait()
        self._running = self._start()

    def stop(self) -> int:
        """Ask it to end, and return its exit code."""
        self._running.terminate()
        return self.wait()

    def wait(self) -> int:
        """Wait for it to end by itself, and return its exit code."""
        return self._running.wait(60)


def write_coarse_sky(path: Path) -> SkyPower:
    """Write the sky power of the Superterp at 24 LST, which a service reads faster than it computes the whole."""
    sky = compute_sky_power(load_instrument("lofar-superterp"), lst_hours=np.arange(24.0))
    write_sky_power(sky, path)
    return sky


@contextmanager
def running(*processes: Process) -> Iterator[None]:
    try:
        yield
    finally:
        for process in processes:
            process.stop()


def make_key(database_url: str, scope: str) -> str:
    """A new key, of a database that has its schema then: made in this process, since to start one takes seconds."""
    with open_factory(database_url) as factory:
        return factory.keys.create((scope,))[1]


@contextmanager
def run_cluster(folder: Path, workers: int) -> Iterator[tuple[str, Sequence[Process]]]:
    """Run a scheduler of dask and workers of one thread on loopback; its address, and the workers."""
    port = find_free_port()
    address = f"tcp://127.0.0.1:{port}"
    more = ("--no-dashboard", "--local-directory", str(folder))
    log = folder / "dask.log"
    scheduler = Process({}, log, "scheduler", "--host", "127.0.0.1", "--port", str(port), more[0], program="dask")
    # without a nanny: whoever kills a worker starts it anew
    begun = [
        Process({}, log, "worker", address, "--nthreads", "1", "--no-nanny", *more, program="dask")
        for _ in range(workers)
    ]
    with running(*begun, scheduler):
        yield address, begun


@dataclass(frozen=True)
class Service:
    """A service that runs: where it answers, the key of an admin, the environment of its commands, its processes."""

    address: str
    key: str
    environment: Mapping[str, str]
    processes: Sequence[Process]


@contextmanager
def run_service(database_url: str, folder: Path, *beside: str, **settings: Any) -> Iterator[Service]:
    """Run a server on an empty database, and other commands beside it, until the block ends; a folder has their log."""
    port = find_free_port()
    address = f"http://127.0.0.1:{port}"
    values = {"database_url": database_url, **settings}
    environment = {f"LBACAL_{name.upper()}": str(value) for name, value in values.items()}
    key = make_key(database_url, "admin")
    serve = ("serve", "--port", str(port), "--api-only")
    processes = [Process(environment, folder / "log", *command) for command in (serve, *((name,) for name in beside))]
    with running(*processes):
        wait_until(lambda: is_ready(address, "healthz"), "the server")
        yield Service(address, key, environment, processes)
