"""The wheels as built, installed into an environment of its own, away from the checkout."""

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

import numpy as np
import pytest

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.spectra.spectra import write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.running.processes import find_free_port, is_ready, wait_until

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
