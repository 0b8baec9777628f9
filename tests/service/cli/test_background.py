from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.config import Settings
from service.storage.database import Database
from service.storage.migration import upgrade

DYING_SCHEDULER = """
from service.cli import background


def die(*_):
    raise ZeroDivisionError


background.run_scheduler = die
background.main()
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    path = tmp_path / "lbacal.sqlite"
    database = Database(Settings(database_url=str(path)).sqlalchemy_url)
    upgrade(database)
    database.close()
    return os.environ | {"LBACAL_DATABASE_URL": str(path)}


@pytest.mark.long
def test_a_child_whose_scheduler_dies_ends_so_that_the_server_starts_another(environment: dict[str, str]) -> None:
    """The thread died alone: the worker lived, /readyz said 200, and no night ever came again."""
    with subprocess.Popen(
        [sys.executable, "-c", DYING_SCHEDULER], env=environment, stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        assert child.wait(60) == 1
        assert child.stderr is not None
        assert b"the scheduler ended" in child.stderr.read()


@pytest.mark.long
def test_a_child_without_its_sky_says_so_and_ends(environment: dict[str, str], tmp_path: Path) -> None:
    environment["LBACAL_SKY_POWER"] = str(tmp_path / "nowhere.json")
    command = [sys.executable, "-m", "service.cli.background"]
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.wait(60) == 1
        assert child.stderr is not None
        (line,) = child.stderr.read().splitlines()
        assert b"nowhere.json" in line
