"""No container engine runs here: the commands and environments of the compose file are run by hand instead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from lbacal.client import Client
from lbacal_core.spectra.spectra import read_spectra
from service.config import Settings
from validation.running.postgres import run_postgres
from validation.running.processes import Process, find_free_port, is_ready, run_command, running, wait_until


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
    assert passed == {f"LBACAL_{name.upper()}" for name in Settings.model_fields}


def test_services_wait_for_what_they_need_are_looked_after_and_reached_from_this_machine_only(
    compose: dict[str, Any],
) -> None:
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
def test_the_commands_of_the_compose_file_are_a_service(compose: dict[str, Any], service: Any, tmp_path: Path) -> None:
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
            spectra = read_spectra(service.spectra)
            client.ingest(spectra.select(spectra.time_unix < 1_420_070_400.0))
            job = client.refit("station", "2014-01-01", "2015-01-01", reason="compose", promote=True)
            assert job["state"] == "done", job
            assert len(client.effective("CS002", at="2014-05-01")) == 96 * 51
        assert [process.stop() for process in processes] == [0, 0, 0, 0]
