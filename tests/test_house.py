"""The rules of the house that no linter knows."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from lbacal.cli.main import FIT

PACKAGES = ("lbacal", "lbacal_core", "service", "proofs", "migrations")


TESTED_WITH_OTHERS = {
    "antenna/ideal.py": "skypower/test_modes.py",
    "antenna/model.py": "antenna/test_varied.py",
    "antenna/names.py": "antenna/test_circuit.py",
    "antenna/table.py": "antenna/test_files.py",
    "calibration/noise.py": "calibration/test_fit.py",
    "discovery/policy.py": "discovery/test_report.py",
    "discovery/view.py": "discovery/test_project.py",
    "causes/amplifier.py": "causes/test_catalogue.py",
    "causes/antenna.py": "causes/test_catalogue.py",
    "causes/interference.py": "causes/test_catalogue.py",
    "causes/receiver.py": "causes/test_catalogue.py",
    "causes/sky.py": "causes/test_catalogue.py",
    "data/tables.py": "lstcurve/test_compare.py",
    "skypower/direct.py": "skypower/test_modes.py",
    "skypower/power.py": "skypower/test_modes.py",
    "traces/blocks.py": "traces/test_background.py",
    "traces/inspection.py": "traces/test_background.py",
    "twin/faults/drivers.py": "twin/faults/test_catalogue.py",
    "twin/faults/fault.py": "twin/faults/test_catalogue.py",
    "twin/hardware.py": "twin/test_campaign.py",
    "twin/scatter.py": "twin/test_campaign.py",
    "twin/settings.py": "twin/test_campaign.py",
    "twin/stages.py": "twin/test_campaign.py",
    "twin/weather.py": "twin/test_campaign.py",
}
"""Files of `lbacal_core` without a test file of their own, and the one whose claims need them."""


def python_files(tracked: list[Path], *folders: str) -> list[Path]:
    return [path for path in tracked if path.suffix == ".py" and path.parts[0] in folders]


def test_imports_go_down_the_stack(repository: Path) -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([lint, "--no-cache"], cwd=repository, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_one_version_of_uv(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    in_script = re.search(r"^UV_VERSION=([0-9.]+)", (repository / "dev").read_text(), re.MULTILINE)
    assert in_script is not None
    assert f"uv=={in_script[1]}" in project["project"]["optional-dependencies"]["dev"]


def test_one_version_of_wheels_changelog_and_citation(repository: Path) -> None:
    client = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    server = tomllib.loads((repository / "wheels/server/pyproject.toml").read_text())["project"]
    assert server["version"] == client["version"]
    assert f"lbacal[fit]=={client['version']}" in server["dependencies"]
    assert f"\n## {client['version']} - " in (repository / "CHANGELOG.md").read_text()
    assert f"\nversion: {client['version']}\n" in (repository / "CITATION.cff").read_text()
    assert client["optional-dependencies"]["server"] == [f"lbacal-server=={client['version']}"]


def test_a_command_looks_for_what_the_extra_fit_installs(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    base, extra = (
        {re.split("[<>=]", one)[0] for one in listed}
        for listed in (project["dependencies"], project["optional-dependencies"]["fit"])
    )
    assert extra - base - {"pyerfa"} == set(FIT), "pyerfa comes with astropy"


def test_files_are_short_enough_to_read(repository: Path, tracked: list[Path]) -> None:
    files = [path for path in tracked if path.suffix == ".py" and path.parts[0] != "tests"]
    lengths = {str(path): len((repository / path).read_text().splitlines()) for path in files}
    assert {path: length for path, length in lengths.items() if length >= 400} == {}


def test_tests_mirror_the_tree(repository: Path, tracked: list[Path]) -> None:
    astray = []
    for path in python_files(tracked, "tests"):
        if len(path.parts) < 3 or path.parts[1] not in PACKAGES or not path.name.startswith("test_"):
            continue
        tested = repository.joinpath(*path.parts[1:-1], path.name.removeprefix("test_"))
        if not tested.is_file() and not tested.with_suffix("").is_dir():
            astray.append(str(path))
    assert astray == []


def test_the_tree_mirrors_its_tests(repository: Path, tracked: list[Path]) -> None:
    """Every file of the science has a test file, or stands with the one that tests it in a list that only shrinks."""
    untested = []
    for path in python_files(tracked, "lbacal_core"):
        name = str(Path(*path.parts[1:]))
        own = repository / "tests" / path.with_name(f"test_{path.name}")
        if path.name == "__init__.py" or own.is_file():
            assert name not in TESTED_WITH_OTHERS, f"{name} has tests of its own now"
        elif not (repository / "tests/lbacal_core" / TESTED_WITH_OTHERS.get(name, "nowhere")).is_file():
            untested.append(str(path))
    assert untested == []
    assert len(TESTED_WITH_OTHERS) <= 25


def test_packages_hold_one_docstring_and_import_nothing(repository: Path, tracked: list[Path]) -> None:
    for path in python_files(tracked, "lbacal_core", "service"):
        if path.name == "__init__.py":
            body = ast.parse((repository / path).read_text()).body
            assert len(body) == 1, path
            assert isinstance(body[0], ast.Expr), path


def test_every_name_of_a_file_has_a_meaning(tracked: list[Path]) -> None:
    empty_words = {"utils", "util", "helpers", "common", "manager", "misc"}
    assert [str(path) for path in python_files(tracked, *PACKAGES, "tests") if path.stem in empty_words] == []


def test_tests_are_found_by_path(tracked: list[Path]) -> None:
    assert [str(path) for path in python_files(tracked, "tests") if path.name == "__init__.py"] == []
