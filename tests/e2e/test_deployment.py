"""What is delivered: the wheels in an environment of their own, and the compose file with its commands run by hand."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lbacal.client import Client
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import read_spectra, write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.config import Settings
from validation.running.postgres import run_postgres
from validation.running.processes import Process, find_free_port, is_ready, run_command, running, wait_until

TREE = (
    "lbacal", "lbacal_core", "lbacal_twin", "lbacal_paper", "service", "migrations", "wheels", "pyproject.toml",
    "README.md", "LICENSE",
)  # fmt: skip


@dataclass(frozen=True)
class Installed:
    """An environment that holds the wheels; commands run in an empty folder beside it."""

    environment: Path
    folder: Path
    settings: dict[str, str]

    @property
    def command(self) -> str:
        return str(self.environment / "bin" / "lbacal")

    def run(self, *arguments: str, **settings: str) -> str:
        """Run `lbacal`, which must succeed, and return what it prints."""
        said = subprocess.run(
            [self.command, *arguments], cwd=self.folder, env=self.settings | settings,
            capture_output=True, text=True, check=False, timeout=900,
        )  # fmt: skip
        assert said.returncode == 0, said.stderr
        return said.stdout

    @contextmanager
    def serve(self) -> Iterator[str]:
        """Serve on a free port; yields the address."""
        port = find_free_port()
        url = f"http://127.0.0.1:{port}"
        with (self.folder / "log").open("wb") as sink:
            command = [self.command, "serve", "--port", str(port)]
            server = subprocess.Popen(command, cwd=self.folder, env=self.settings, stdout=sink, stderr=sink)
            try:
                wait_until(lambda: is_ready(url), "the server")
                yield url
            finally:
                server.terminate()
                server.wait(30)


@pytest.fixture(scope="module")
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Builds all wheels from a copy of the tree; libraries come from the environment that runs the tests."""
    tree, folder = tmp_path_factory.mktemp("tree"), tmp_path_factory.mktemp("elsewhere")
    for name in TREE:
        source = request.config.rootpath / name
        if source.is_dir():
            shutil.copytree(source, tree / name)
        else:
            shutil.copy2(source, tree / name)
    uv = str(Path(sys.executable).with_name("uv"))
    for project in (tree, *(tree / "wheels").iterdir()):
        build = [uv, "build", "--wheel", "--no-build-isolation", "--offline", "--python", sys.executable]
        subprocess.run([*build, "--out-dir", str(tree / "dist"), str(project)], check=True, capture_output=True)
    environment = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run(
        [uv, "venv", "--offline", "--python", sys.executable, str(environment)], check=True, capture_output=True
    )
    python = str(environment / "bin" / "python")
    wheels = [str(wheel) for wheel in (tree / "dist").glob("*.whl")]
    assert len(wheels) == 4
    install = [uv, "pip", "install", "--offline", "--no-deps", "--python", python, *wheels]
    subprocess.run(install, check=True, capture_output=True)
    # a folder named in a .pth is searched, its own .pth files (the editable checkout) are not
    purelib = next(environment.glob("lib/python*/site-packages"))
    (purelib / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    settings = {name: value for name, value in os.environ.items() if not name.startswith(("LBACAL_", "PYTHON"))}
    settings |= {"LBACAL_DATABASE_URL": str(folder / "lbacal.sqlite"), "LBACAL_POLL_S": "0.1", "COLUMNS": "200"}
    settings |= {"LBACAL_GATE_ERROR": "0.3", "LBACAL_GATE_CHANGE": "0.5"}
    return Installed(environment, folder, settings)


def test_the_wheels_bring_their_own_code(installed: Installed) -> None:
    python = str(installed.environment / "bin" / "python")
    for package in ("lbacal", "lbacal_core", "lbacal_twin", "lbacal_paper", "service", "migrations"):
        command = [python, "-c", f"import {package}; print(*{package}.__path__)"]
        said = subprocess.run(
            command, cwd=installed.folder, env=installed.settings, capture_output=True, text=True, check=True
        )
        assert Path(said.stdout.strip()).is_relative_to(installed.environment)


def test_an_installed_lbacal_fits_and_serves_what_is_in_effect(installed: Installed) -> None:
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(stations=("CS002",), antennas=2, years=0.99, events_per_year=100)
    campaign = simulate_campaign(settings, instrument, compute_sky_power(instrument), np.random.default_rng(8))
    write_spectra(campaign.spectra, installed.folder / "S.h5")
    installed.run("fit", "S.h5", "--instrument", "lofar-superterp", "--output", "C.ecsv", "--report", "fit.json")
    statuses = [curve["status"] for curve in json.loads((installed.folder / "fit.json").read_text())["curves"]]
    assert statuses == ["converged"] * 4

    installed.run("db", "upgrade")
    key = installed.run("keys", "create", "--scope", "admin").splitlines()[-1]
    with installed.serve() as url:
        reach = {"LBACAL_URL": url, "LBACAL_API_KEY": key}
        installed.run("ingest", "S.h5", **reach)
        year = ("--since", "2014-01-01", "--until", "2015-01-01")
        installed.run("refit", "--scope", "antenna", *year, "--reason", "first", "--promote", **reach)
        path = ("--station", "CS002", "--antenna", "0", "--dipole", "X")
        said = installed.run("effective", *path, "--at", "2014-06-01", **reach)
    assert said.startswith("CS002 antenna 0 X: version ")


@pytest.fixture(scope="module")
def compose(request: pytest.FixtureRequest) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((request.config.rootpath / "docker-compose.yml").read_text())
    return content


def environment_of(service: dict[str, Any], database_url: str) -> dict[str, str]:
    """The environment of a service where only the password is set, and the database is ours."""
    filled = {name: value for name, value in service["environment"].items() if value is not None}
    assert filled["LBACAL_DATABASE_URL"] == "postgresql://lbacal@db/lbacal"
    return filled | {"LBACAL_DATABASE_URL": database_url}


def test_every_setting_is_passed_on(compose: dict[str, Any]) -> None:
    passed = {name for name in compose["services"]["api"]["environment"] if name.startswith("LBACAL_")}
    assert passed == {f"LBACAL_{name.upper()}" for name in Settings.model_fields} | {"LBACAL_DASK"}


def test_services_wait_for_what_they_need_are_looked_after_and_reached_from_here_only(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert services["api"]["ports"] == ["${BIND:-127.0.0.1}:${PORT:-8000}:8000"]
    for name, service in services.items():
        assert service["logging"]["options"] == {"max-size": "10m", "max-file": "5"}
        assert "healthcheck" in service or name == "migrate"
    assert set(services) == {"db", "migrate", "api", "scheduler", "worker"}
    assert services["migrate"]["depends_on"] == {"db": {"condition": "service_healthy"}}
    for name in ("api", "scheduler", "worker"):
        assert services[name]["depends_on"] == {"migrate": {"condition": "service_completed_successfully"}}
        assert services[name]["build"] == "."
    known = {"build", "image", "restart", "environment", "depends_on", "command", "ports", "healthcheck", "deploy"}
    known |= {"volumes", "logging"}
    assert all(set(service) <= known for service in services.values())
    assert set(compose["volumes"]) == {"db"}


def is_done(environment: dict[str, str], *arguments: str) -> bool:
    """Whether a command ends with 0."""
    command = [sys.executable, "-m", "lbacal", *arguments]
    return subprocess.run(command, env=os.environ | environment, capture_output=True, check=False).returncode == 0


@pytest.mark.usefixtures("needs_postgres")
def test_the_commands_of_the_compose_file_are_a_service(compose: dict[str, Any], fitted: Path, tmp_path: Path) -> None:
    services, log = compose["services"], tmp_path / "log"
    with run_postgres() as url:
        environment = {name: environment_of(services[name], url) for name in ("migrate", "api", "scheduler", "worker")}
        refused = Process(environment["api"], log, *services["api"]["command"])
        assert refused.wait() == 1, "on PostgreSQL an empty schema is refused"
        assert "run `lbacal db upgrade`" in log.read_text()
        run_command(environment["migrate"], *services["migrate"]["command"])
        key = run_command(environment["api"], "keys", "create", "--scope", "admin").splitlines()[-1]
        port = find_free_port()
        command = [str(port) if part == "8000" else part for part in services["api"]["command"]]
        processes = [
            Process(environment["api"], log, *command),
            Process(environment["scheduler"], log, *services["scheduler"]["command"]),
            *(Process(environment["worker"], log, *services["worker"]["command"]) for _ in range(2)),
        ]
        address = f"http://127.0.0.1:{port}"
        with running(*processes), Client(address, key) as client:
            wait_until(lambda: is_ready(address), "the api and a worker")
            for name in ("scheduler", "worker"):
                _, _, *check = services[name]["healthcheck"]["test"]
                wait_until(lambda check=check: is_done(environment["worker"], *check), f"the {name}")
            spectra = read_spectra(fitted / "spectra.h5")
            client.ingest(spectra.select(spectra.time_unix < 1_420_070_400.0))
            job = client.refit("station", "2014-01-01", "2015-01-01", reason="compose", promote=True)
            assert job["state"] == "done", job
            assert len(client.effective("CS002", at="2014-05-01")) == 96 * 51
        assert [process.stop() for process in processes] == [0, 0, 0, 0]
