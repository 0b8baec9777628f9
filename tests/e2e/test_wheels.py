"""Both wheels, really installed into empty environments, used from a folder outside the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from lbacal.cli.main import FIT, SERVER
from proofs.running.processes import find_free_port

pytestmark = pytest.mark.slow
UV = Path(sys.executable).with_name("uv")
REQUIRED = {
    "fit": ["--instrument", "a", "--output", "b", "--report", "c", "d"],
    "investigate": ["--report", "c"],
    "lst-curve": ["--report", "c", "d"],
    "sky-power": ["--instrument", "a", "--output", "b"],
    "spectra": ["d"],
}
"""The commands that compute, with the arguments that they cannot do without."""
of_oldest = pytest.mark.skipif(sys.version_info >= (3, 12), reason="the oldest libraries have wheels for Python 3.11")


def uv(*arguments: str | Path, cwd: Path) -> str:
    done = subprocess.run([UV, *arguments], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@dataclass(frozen=True)
class Installation:
    """An environment with the wheels, and a folder to work in."""

    python: Path
    folder: Path

    def run(self, *command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run something of the environment, which must not find the checkout."""
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LBACAL_"))}
        return subprocess.run(
            [self.python.with_name(str(command[0])), *command[1:]], cwd=self.folder, env=clean | environment,
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip


@pytest.fixture(scope="module")
def source(repository: Path, tracked: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is under version control, copied: a build leaves files behind, and may take in older ones."""
    folder = tmp_path_factory.mktemp("source")
    try:
        uv(
            "pip",
            "install",
            "--dry-run",
            "--refresh-package",
            "setuptools",
            "--target",
            folder,
            "setuptools",
            cwd=folder,
        )
    except AssertionError as error:
        pytest.skip(f"needs a package index: {str(error).splitlines()[0]}")
    for path in tracked:
        if path.parts[0] in ("lbacal", "lbacal_core", "service", "migrations", "wheels") or len(path.parts) == 1:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(repository / path, folder / path)
    return folder


@pytest.fixture(scope="module")
def wheels(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The client's and the server's wheel."""
    folder = tmp_path_factory.mktemp("wheels")
    uv("build", "--wheel", "--out-dir", folder, source, cwd=source)
    uv("build", "--wheel", "--out-dir", folder, source / "wheels/server", cwd=source)
    (client,), (server,) = folder.glob("lbacal-*.whl"), folder.glob("lbacal_server-*.whl")
    return {"client": client, "server": server}


@pytest.fixture(scope="module")
def install(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Sequence[str | Path]], Installation]:
    """Make an environment with what is named."""

    def made(wanted: Sequence[str | Path]) -> Installation:
        folder = tmp_path_factory.mktemp("installed")
        uv("venv", "--python", sys.executable, folder / "env", cwd=folder)
        python = folder / "env/bin/python"
        uv("pip", "install", "--python", python, *wanted, cwd=source)
        return Installation(python, folder)

    return made


def top_of(wheel: Path) -> set[str]:
    names = {name.partition("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    return {name for name in names if not name.endswith(".dist-info")}


def test_a_wheel_holds_every_file_of_its_packages(wheels: dict[str, Path], tracked: list[Path]) -> None:
    for name, packages in (("client", {"lbacal", "lbacal_core"}), ("server", {"service", "migrations"})):
        held = {one for one in zipfile.ZipFile(wheels[name]).namelist() if ".dist-info/" not in one}
        assert top_of(wheels[name]) == packages
        assert held == {str(path) for path in tracked if path.parts[0] in packages}


@of_oldest
def test_a_pipeline_needs_the_base_only_and_its_oldest_libraries_will_do(
    wheels: dict[str, Path], install: Callable[..., Installation], service: Any
) -> None:
    pipeline = install(["--resolution", "lowest-direct", "--requirements", "pyproject.toml", wheels["client"]])
    reach = {name: service.environment[name] for name in ("LBACAL_URL", "LBACAL_API_KEY")}
    path = ("--station", "CS002", "--antenna", "1", "--dipole", "X", "--at", "2014-05-01")
    said = pipeline.run("lbacal", "effective", *path, **reach)
    assert said.stdout.startswith("CS002 antenna 1 X: version "), said.stderr
    again = pipeline.run("lbacal", "ingest", service.spectra, **reach)
    assert again.stdout == "796 spectra sent: 0 stored, 796 there already\n", again.stderr
    program = """
import sys, lbacal
table = lbacal.effective("CS002", antenna=1, dipole="X", at="2014-05-01")
table.write("C.ecsv")
print(len(table), table["c"].unit, *sorted(set(sys.modules) & {"scipy", "healpy", "matplotlib", "service", "typer"}))
"""
    assert pipeline.run("python", "-W", "error", "-c", program, **reach).stdout == "51 V\n"
    for command, required in REQUIRED.items():
        refused = pipeline.run("lbacal", command, *required)
        sentence = f"lbacal: lbacal {command} needs the extra fit: pip install 'lbacal[fit]'\n"
        assert (refused.returncode, refused.stdout, refused.stderr) == (2, "", sentence)
    for command in SERVER:
        for more in ([], ["--help", "--port", "1"]):
            refused = pipeline.run("lbacal", command, *more)
            sentence = f"lbacal: lbacal {command} needs the extra server: pip install 'lbacal[server]'\n"
            assert (refused.returncode, refused.stdout, refused.stderr) == (2, "", sentence)


@of_oldest
def test_a_fit_needs_the_extra_fit_and_its_oldest_libraries_will_do(
    wheels: dict[str, Path], install: Callable[..., Installation], service: Any
) -> None:
    oldest = ["--resolution", "lowest-direct", "--requirements", "pyproject.toml", "--extra", "fit"]
    laptop = install([*oldest, wheels["client"]])
    arguments = ("--instrument", "lofar-superterp", "--scope", "station", "--output", "C.ecsv", "--report", "fit.json")
    done = laptop.run("lbacal", "fit", service.spectra, *arguments)
    assert done.stdout.startswith("2 of 2 curves converged"), done.stderr
    reports = ("--report", "R.json", "--html", "R.html")
    done = laptop.run("lbacal", "investigate", "--lst-curve", _measured(laptop), *reports)
    assert "explained; wrote R.json and R.html" in done.stdout, done.stderr
    known = laptop.run("python", "-c", f"import {', '.join(FIT)}")
    assert known.returncode == 0, known.stderr


def _measured(laptop: Installation) -> str:
    found = "from importlib.resources import files; print(files('lbacal_core.data') / 'measured_lst_variation.csv')"
    return laptop.run("python", "-c", found).stdout.strip()


def test_a_server_outside_the_checkout_makes_its_database_and_answers(
    wheels: dict[str, Path], install: Callable[..., Installation]
) -> None:
    server = install(["--constraints", "requirements.lock", wheels["client"], wheels["server"]])
    top = {path.name for path in server.python.parents[1].glob("lib/python*/site-packages/*")}
    assert {"lbacal", "lbacal_core", "service", "migrations"} <= top
    assert server.run("lbacal", "--version").stdout == f"lbacal {wheels['client'].name.split('-')[1]}\n"
    upgraded = server.run("lbacal", "db", "upgrade")
    assert upgraded.stdout.startswith("schema "), upgraded.stderr
    port = find_free_port()
    url = f"http://127.0.0.1:{port}"
    command = [server.python.with_name("lbacal"), "serve", "--port", str(port)]
    with subprocess.Popen(command, cwd=server.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            end = time.monotonic() + 60
            while server.run("lbacal", "status", LBACAL_URL=url).returncode and time.monotonic() < end:
                assert process.poll() is None, "the server ended"
            refused = server.run("lbacal", "effective", "--at", "2014-05-01", LBACAL_URL=url)
            assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
            assert "no calibration is in effect" in refused.stderr
        finally:
            process.terminate()
