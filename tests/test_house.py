"""The rules of the house that no linter knows."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from lbacal import FIT

PACKAGES = ("lbacal", "lbacal_core", "lbacal_paper", "lbacal_twin", "service", "validation", "migrations")


def python_files(tracked: list[Path], *folders: str) -> list[Path]:
    return [path for path in tracked if path.suffix == ".py" and path.parts[0] in folders]


def test_imports_go_down_the_stack(repository: Path) -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([lint, "--no-cache"], cwd=repository, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_calibrate_reaches_no_more_rooms() -> None:
    """41 before the redesign, files beside the packages among them; 10 is the aim."""
    rooms = "{name.split('.')[1] for name in sys.modules if name.startswith('lbacal_core.')}"
    script = f"import sys, lbacal_core.pipeline; print(len({rooms}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 17


def test_one_version_of_uv(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    in_script = re.search(r"^UV_VERSION=([0-9.]+)", (repository / "dev").read_text(), re.MULTILINE)
    assert in_script is not None
    assert f"uv=={in_script[1]}" in project["project"]["optional-dependencies"]["dev"]


def test_one_version_of_wheels_changelog_and_citation(repository: Path) -> None:
    client = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    for path in sorted(repository.glob("wheels/*/pyproject.toml")):
        wheel = tomllib.loads(path.read_text())["project"]
        assert wheel["version"] == client["version"]
        ours = [one for one in wheel["dependencies"] if one.startswith("lbacal")]
        assert ours
        assert all(one.endswith(f"=={client['version']}") for one in ours)
        extra = path.parent.name
        assert client["optional-dependencies"][extra] == [f"lbacal-{extra}=={client['version']}"]
    assert f"\n## {client['version']} - " in (repository / "CHANGELOG.md").read_text()
    assert f"\nversion: {client['version']}\n" in (repository / "CITATION.cff").read_text()


def test_a_command_looks_for_what_the_extra_fit_installs(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    base, extra = (
        {re.split("[<>=]", one)[0] for one in listed}
        for listed in (project["dependencies"], project["optional-dependencies"]["fit"])
    )
    assert extra - base - {"pyerfa"} == set(FIT), "pyerfa comes with astropy"


def test_packages_hold_one_docstring_and_import_nothing(repository: Path, tracked: list[Path]) -> None:
    for path in python_files(tracked, "lbacal_core", "lbacal_paper", "lbacal_twin", "service"):
        if path.name == "__init__.py":
            body = ast.parse((repository / path).read_text()).body
            assert len(body) == 1, path
            assert isinstance(body[0], ast.Expr), path


def test_every_name_of_a_file_has_a_meaning(tracked: list[Path]) -> None:
    empty_words = {"utils", "util", "helpers", "common", "manager", "misc"}
    assert [str(path) for path in python_files(tracked, *PACKAGES, "tests") if path.stem in empty_words] == []


def test_tests_are_found_by_path(tracked: list[Path]) -> None:
    assert [str(path) for path in python_files(tracked, "tests") if path.name == "__init__.py"] == []
