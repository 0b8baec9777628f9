"""The image, built and run where no container engine is: the services of docker-compose.yml, and the main job.

debootstrap makes the base image (Debian with its own Python), buildah builds the Dockerfile on it and runs commands in
the image by chroot; both are packages of Debian and want to be root. Commands, environment, volumes, order, replicas
and health checks are those that docker-compose.yml states. In the place of the image postgres:17 stands the PostgreSQL
of this machine, on loopback, with the user, database and password of the service `db`. Nothing is restarted.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import tarfile
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
import yaml

from lbacal.client import Client
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.machinery.claims import Found, exactly
from validation.machinery.parts import Part, Row
from validation.running.postgres import Server, find_binaries
from validation.running.processes import find_free_port, is_ready, wait_until, write_coarse_sky

TREE = Path(__file__).parents[1]
RELEASE = "bookworm"
"""Debian 12 has Python 3.11, as the Dockerfile's own base image has."""
PACKAGES = ("python3", "python3-pip", "python3-venv", "ca-certificates")
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
BASE, IMAGE = "localhost/lbacal-base", "localhost/lbacal"
PASSWORD = "of the proof: 'any' $character"  # noqa: S105 - of a server that ends with this
TO_NUMBER = 'echo $$ > "/numbers/$0"; exec "$@"'
"""A shell that tells its number and becomes a command: buildah passes no signal on."""


@dataclass
class Images:
    """Images and containers in a folder of their own."""

    folder: Path

    def run(self, *arguments: str) -> str:
        """Run buildah to its end, and return what it printed."""
        done = subprocess.run(self.command(*arguments), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"buildah {' '.join(arguments)}: {done.stderr[-2000:]}")
        return done.stdout.strip()

    def command(self, *arguments: str) -> list[str]:
        """A command of buildah with the places of this folder."""
        places = ("--root", str(self.folder / "images"), "--runroot", str(self.folder / "run"))
        return ["buildah", *places, "--storage-driver", "vfs", *arguments]

    def make_base(self) -> None:
        """Make an image of Debian with what the Dockerfile asks of its base: `python`, and a pip that installs."""
        root, packed = self.folder / "debian", self.folder / "debian.tar"
        asked = ["debootstrap", "--variant=minbase", f"--include={','.join(PACKAGES)}", RELEASE, str(root)]
        subprocess.run(asked, check=True, stdout=subprocess.DEVNULL)
        (root / "usr/bin/python").symlink_to("python3")
        for marked in root.glob("usr/lib/python3*/EXTERNALLY-MANAGED"):
            marked.unlink()
        shutil.copyfile(CERTIFICATES, root / CERTIFICATES.relative_to("/"))  # those that this machine trusts
        with tarfile.open(packed, "w") as archive:  # which keeps the owners that a copied folder loses
            archive.add(root, ".")
        container = self.run("from", "scratch")
        self.run("add", container, str(packed), "/")
        self.run("config", "--env", f"SSL_CERT_FILE={CERTIFICATES}", "--env", f"PIP_CERT={CERTIFICATES}", container)
        self.run("commit", "--rm", container, BASE)

    def build(self) -> None:
        """Build the Dockerfile."""
        self.run("bud", "--isolation=chroot", "--build-arg", f"BASE={BASE}", "--tag", IMAGE, str(TREE))


@dataclass
class Composed:
    """The services of docker-compose.yml in one container, which has their network and files."""

    images: Images
    services: Mapping[str, Any]
    settings: Mapping[str, str]
    """What stands in the environment of whoever calls compose."""
    port: int
    done: list[str] = field(default_factory=list)
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.container = self.images.run("from", "--add-host", "db:127.0.0.1", IMAGE)
        config = json.loads(self.images.run("inspect", "--type", "image", IMAGE))["OCIv1"]["config"]
        self.entrypoint: list[str] = config["Entrypoint"]
        self.numbers = self.images.folder / "numbers"
        self.numbers.mkdir()
        self.numbers.chmod(0o777)

    def up(self) -> None:
        """Start every service once what it depends on is as far as it says."""
        waiting = [name for name in self.services if name != "db"]
        while waiting:
            name = next(one for one in waiting if not set(self.services[one]["depends_on"]) & set(waiting))
            for other, asked in self.services[name]["depends_on"].items():
                self._wait(other, asked["condition"])
            for number in range(self.services[name].get("deploy", {}).get("replicas", 1)):
                self._start(name, f"{name}-{number}")
            waiting.remove(name)
        for name in ("api", "scheduler", "worker"):
            self._wait(name, "service_healthy")

    def run(self, name: str, *command: str) -> str:
        """Run a command in a service, to its end."""
        return self.images.run(*self._inside(name), *command)

    def down(self) -> dict[str, int]:
        """Ask every process to end; their exit codes."""
        for label, process in self.processes.items():
            self._ask_to_end(self.numbers / label, process)
        return {label: process.wait(60) for label, process in self.processes.items()}

    def _ask_to_end(self, number: Path, process: subprocess.Popen[bytes]) -> None:
        def is_known() -> bool:
            return process.poll() is not None or (number.is_file() and number.read_text().endswith("\n"))

        wait_until(is_known, f"the number of {number.name}")
        if process.poll() is None:
            os.kill(int(number.read_text()), signal.SIGTERM)

    def _inside(self, name: str) -> list[str]:
        service = self.services[name]
        given = {
            key: self._fill(value) if value else self.settings.get(key) for key, value in service["environment"].items()
        }
        environment = [f"--env={key}={value}" for key, value in given.items() if value is not None]
        # the server on loopback has a port of its own
        environment += [f"--env=PGPORT={self.settings['PGPORT']}"]
        volumes = [f"--volume={self._fill(one)}" for one in service["volumes"]]
        numbers = f"--volume={self.numbers}:/numbers"
        return ["run", "--isolation=chroot", *environment, *volumes, numbers, self.container, "--"]

    def _fill(self, text: str) -> str:
        return re.sub(r"\$\{(\w+)[^}]*\}", lambda found: self.settings[found[1]], text)

    def _start(self, name: str, label: str) -> None:
        command = [str(self.port) if one == "8000" else one for one in self.services[name]["command"]]
        shell = ["sh", "-c", TO_NUMBER, label, *self.entrypoint, *command]
        with (self.images.folder / f"{label}.log").open("wb") as log:
            started = self.images.command(*self._inside(name), *shell)
            self.processes[label] = subprocess.Popen(started, stdout=log, stderr=log)
        self.done.append(f"{label} started")

    def _wait(self, name: str, condition: str) -> None:
        if condition == "service_completed_successfully":
            code = self.processes[f"{name}-0"].wait(120)
            if code != 0:
                raise RuntimeError(f"{name}: {(self.images.folder / f'{name}-0.log').read_text()[-2000:]}")
        else:
            wait_until(lambda: self.is_healthy(name), f"a healthy {name}")
        self.done.append(f"{name}: {condition}")

    def is_healthy(self, name: str) -> bool:
        """Whether the health check of a service ends with 0."""
        how, *check = self.services[name]["healthcheck"]["test"]
        if how != "CMD":
            raise ValueError(f"{name}: a health check by {how}")
        check = [one.replace(":8000/", f":{self.port}/") for one in check]
        if name == "db":
            where = ("--host=127.0.0.1", f"--port={self.settings['PGPORT']}")
            asked = [str(Path(find_binaries() or "") / check[0]), *where, *check[1:]]
        else:
            asked = self.images.command(*self._inside(name), *check)
        return subprocess.run(asked, capture_output=True, check=False).returncode == 0


@contextmanager
def run_database(environment: Mapping[str, str], port: int) -> Iterator[None]:
    """PostgreSQL on a port of loopback, asking for the password that the service `db` is given."""
    binaries = find_binaries()
    if binaries is None:
        raise FileNotFoundError("no PostgreSQL server binaries: install postgresql")
    with tempfile.TemporaryDirectory(prefix="lbacal-pg-") as name:
        server = Server(Path(name), binaries, port)
        server.make()
        server.start()
        user, database = environment["POSTGRES_USER"], environment["POSTGRES_DB"]
        with psycopg.connect(server.url, autocommit=True) as connection:
            connection.execute(f"ALTER ROLE {user} PASSWORD '{PASSWORD.replace(chr(39), 2 * chr(39))}'")
            connection.execute(f"CREATE DATABASE {database}")
        server.ask_for_passwords()
        try:
            yield
        finally:
            server.stop()


def run_image(seed: int) -> Row:
    """Make the base, build the image, start the services, do the main job, and stop them."""
    services = yaml.safe_load((TREE / "docker-compose.yml").read_text())["services"]
    took = {}
    with tempfile.TemporaryDirectory(prefix="lbacal-image-", ignore_cleanup_errors=True) as name, ExitStack() as stack:
        images, files = Images(Path(name)), Path(name) / "files"
        Path(name).chmod(0o755)
        files.mkdir()
        for what, work in (("base", images.make_base), ("image", images.build)):
            begun = time.monotonic()
            work()
            took[what] = round(time.monotonic() - begun, 1)
        settings = {"POSTGRES_PASSWORD": PASSWORD, "FILES": str(files), "LBACAL_SKY_POWER": "/files/sky_power.json"}
        settings["PGPORT"] = str(port := find_free_port())
        sky = write_coarse_sky(files / "sky_power.json")
        stack.enter_context(run_database(services["db"]["environment"], port))
        composed = Composed(images, services, settings, find_free_port())
        begun = time.monotonic()
        try:
            composed.up()
            differs = do_main_job(composed, sky, seed)
        finally:
            codes = composed.down()
        took["services"] = round(time.monotonic() - begun, 1)
    ended = {label: code for label, code in codes.items() if code}
    return {"seconds": took, "done": composed.done, "ended": ended, "differs": differs}


def do_main_job(composed: Composed, sky: Any, seed: int) -> float:
    """Send a year, refit, and ask what is in effect; the largest difference of C from the fit alone, a fraction."""
    address = f"http://127.0.0.1:{composed.port}"
    wait_until(lambda: is_ready(address), "the api, a worker and the database")
    key = composed.run("api", *composed.entrypoint, "keys", "create", "--scope", "admin").splitlines()[-1]
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(stations=("CS002",), antennas=6, years=0.99, events_per_year=150)
    spectra = simulate_campaign(settings, instrument, sky, np.random.default_rng(seed)).spectra
    window = spectra.select(spectra.time_unix < 1_420_070_400.0)
    with Client(address, key) as client:
        client.ingest(window)
        job = client.refit("antenna", "2014-01-01", "2015-01-01", reason="proof", promote=True)
        if job["state"] != "done":
            raise RuntimeError(f"the refit: {job}")
        answer = client.get("/v1/calibrations/effective", at="2014-06-01", station="CS002")
    here = {
        (one.antenna, one.dipole): one.c
        for one in fit_calibration(window, Simulation(instrument, sky), "antenna").curves
    }
    told = {(one["antenna"], one["dipole"]): one["c"] for one in answer["curves"] if one["answered_by"] == "antenna"}
    if told.keys() != here.keys():
        raise RuntimeError(f"{len(told)} paths answer, {len(here)} were sent")
    composed.done.append(f"C of {len(told)} paths in effect")
    return max(float(np.nanmax(np.abs(np.array(told[path], dtype=float) / here[path] - 1.0))) for path in here)


def judge(rows: Sequence[Row]) -> list[Found]:
    """Whether all of it ran, and what C differs by."""
    return [
        exactly("ended", sum(len(row["ended"]) for row in rows), n=len(rows)),
        exactly("differs", max(row["differs"] for row in rows), n=len(rows)),
    ]


PARTS = (Part("chroot", run_image, judge, 1, has_chance=False, is_parallel=False),)
