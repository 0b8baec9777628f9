from __future__ import annotations

import fcntl
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings
from validation.running.processes import PATIENCE_S, Process, find_free_port, get, is_ready, running, wait_until

QUIET = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
expect.set_options(timeout=30_000)  # a busy machine fails no test
SPECTRA, TRUTH = "spectra.h5", "truth.npy"
STEP = GainStep(size=-0.15, date="2015-07-01", where=Where(antennas=(1,), dipoles=("Y",)))
Run = Callable[..., subprocess.CompletedProcess[str]]


@dataclass(frozen=True)
class Service:
    """A running `lbacal serve`, with the environment that reaches it."""

    url: str
    environment: dict[str, str]
    spectra: Path

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command of `lbacal` as a user would."""
        return subprocess.run(
            [sys.executable, "-m", "lbacal", *arguments], env={**self.environment, **environment},
            capture_output=True, text=True, check=False, timeout=900,
        )  # fmt: skip

    def do(self, *arguments: str) -> str:
        """Run a command of `lbacal` that must succeed, and return what it printed."""
        said = self.run(*arguments)
        assert said.returncode == 0, said.stderr
        return said.stdout

    def pass_night(self, last: Collection[str] = ()) -> None:
        """Enqueue what is due, and wait until all of it has ended, the kinds that come last among it."""
        self.do("scheduler", "--once")
        wait_until(lambda: _is_idle(self.url, last), "the night to end")


@pytest.fixture(scope="session")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of two years of two antennas, one with a step, ingested and fitted with the commands of the README."""
    settings = TwinSettings(stations=("CS002",), antennas=2, years=1.99, events_per_year=140)
    return make_once(tmp_path_factory, "fitted", settings, {"watch", "investigation"}, [STEP])


@pytest.fixture(scope="session")
def service(fitted: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service of these years."""
    with serve_copy(fitted, tmp_path_factory) as made:
        yield made


@pytest.fixture(scope="session")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The same with a clock that is two hours behind, in the year 2014: misfits, nothing in effect, and no drift."""
    settings = TwinSettings(stations=("CS002",), antennas=2, years=0.99, events_per_year=200)
    state = make_once(tmp_path_factory, "faulty", settings, {"investigation"}, [LstOffset(size=2.0)])
    with serve_copy(state, tmp_path_factory) as made:
        yield made


def make_once(
    factory: pytest.TempPathFactory,
    name: str,
    settings: TwinSettings,
    last: Collection[str],
    faults: Sequence[Fault] = (),
) -> Path:
    """The folder of a service after its first night, made by one process of the tests for all of them."""
    common = factory.getbasetemp()
    common = common.parent if "PYTEST_XDIST_WORKER" in os.environ else common
    made = common / f"{name}-made"
    with (common / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.is_dir():
            new = factory.mktemp(name)
            make_state(new, settings, last, faults)
            new.rename(made)  # whole or not there: what could not be made is tried again
    return made


@contextmanager
def serve_copy(state: Path, factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service on a copy of a folder, with all its processes."""
    folder = factory.mktemp("service") / "copy"
    shutil.copytree(state, folder)
    with serve(folder) as made:
        wait_until(lambda: _are_all_there(made.url), "the scheduler and the worker")
        yield made


def _are_all_there(url: str) -> bool:
    """Whether API, scheduler and worker live."""
    processes = get(f"{url}/v1/status", timeout=PATIENCE_S).json()["processes"]
    return {one["kind"] for one in processes} == {"api", "scheduler", "worker"}


def make_state(folder: Path, settings: TwinSettings, last: Collection[str], faults: Sequence[Fault]) -> None:
    """A service with the spectra of a simulated campaign, one of whose nights has passed, up to its last jobs."""
    spectra = folder / SPECTRA
    instrument = load_instrument("lofar-superterp")
    sky = compute_sky_power(instrument)
    campaign = simulate_campaign(settings, instrument, sky, np.random.default_rng(5), faults)
    write_spectra(campaign.spectra, spectra)
    np.save(folder / TRUTH, campaign.truth.curve("Y", "CS002", 1))
    with serve(folder) as made:
        made.do("ingest", str(spectra))
        made.pass_night(last)
    with closing(sqlite3.connect(folder / "lbacal.sqlite")) as connection, connection:
        # scheduler and worker end with their server at once, and count as alive for a minute
        connection.execute("DELETE FROM process")


@contextmanager
def serve(folder: Path) -> Iterator[Service]:
    """The service of a folder, which holds its spectra and its database, and the key of an administrator."""
    port = find_free_port()
    url = f"http://127.0.0.1:{port}"
    environment = os.environ | {
        "LBACAL_DATABASE_URL": str(folder / "lbacal.sqlite"), "LBACAL_URL": url, "LBACAL_POLL_S": "0.5",
        "LBACAL_GATE_ERROR": "0.3", "LBACAL_GATE_CHANGE": "0.5", "COLUMNS": "200",
        "LBACAL_CUT_WINDOWS": "false",  # a step waits for somebody to put it in force
    }  # fmt: skip
    with running(Process(environment, folder / "log", "serve", "--port", str(port))):
        wait_until(lambda: is_ready(url), "the server to answer")
        made, key = Service(url, environment, folder / SPECTRA), folder / "key"
        if not key.exists():
            key.write_text(made.do("keys", "create", "--scope", "admin").splitlines()[-1])
        made.environment["LBACAL_API_KEY"] = key.read_text()
        yield made


def _is_idle(url: str, last: Collection[str]) -> bool:
    jobs = get(f"{url}/v1/jobs", timeout=PATIENCE_S).json()["jobs"]
    are_last_there = set(last) <= {job["kind"] for job in jobs}
    return are_last_there and all(job["state"] in ("done", "failed") for job in jobs)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, which talks to nobody by itself."""
    executable = shutil.which("chromium")
    if executable is None:
        if os.environ.get("CI"):
            raise FileNotFoundError("no chromium: apt-get install chromium")
        pytest.skip("needs chromium")
    with sync_playwright() as playwright:
        # the five seconds of the library are short of a page with plots on a machine that runs the whole suite
        expect.set_options(timeout=60_000)
        made = playwright.chromium.launch(executable_path=executable, args=QUIET)
        yield made
        made.close()
