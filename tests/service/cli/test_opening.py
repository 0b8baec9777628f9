"""Whatever is wrong around a command of the service, it ends with one sentence and exit 1 or 2, never a traceback."""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from importlib.metadata import entry_points
from pathlib import Path

import psycopg
import pytest
import typer

from lbacal.cli.main import ADDED, ENTRY_POINTS, add_commands, app
from lbacal_core.errors import BadInputError
from service.cli import background
from service.config import Settings, read_settings
from service.storage.database import Database
from service.storage.migration import upgrade
from validation.running.processes import Process, find_free_port, get, is_ready, run_command, running, wait_until

Ended = tuple[tuple[str, ...], int, str, str]
"""Arguments of a command, its exit code, and what it said."""
CHECK, UPGRADE, LIST = ("db", "check"), ("db", "upgrade"), ("keys", "list")
COMMANDS = (CHECK, UPGRADE, LIST, ("worker", "--until-idle"), ("scheduler", "--once"), ("serve", "--port", "1"))
WORLDS = {
    "garbage": ({"DATABASE_URL": "{folder}/garbage.sqlite"}, 1, "not an SQLite database"),
    "truncated": ({"DATABASE_URL": "{folder}/half.sqlite"}, 1, "damaged"),
    "a folder": ({"DATABASE_URL": "{folder}"}, 1, "cannot be opened"),
    "below a file": ({"DATABASE_URL": "{folder}/file/x.sqlite"}, 2, "name a file that can be used here"),
    "empty name": ({"DATABASE_URL": ""}, 2, "LBACAL_DATABASE_URL: expected a file, or postgresql://"),
    "mysql": (
        {"DATABASE_URL": "mysql://me:hidden-word@host/lbacal"}, 2,
        "LBACAL_DATABASE_URL: expected a file, or postgresql://",
    ),
    "bad port": (
        {"DATABASE_URL": "postgresql://me:hidden-word@host:port/lbacal"}, 2,
        "LBACAL_DATABASE_URL: expected a number as port",
    ),
    "absent server": (
        {"DATABASE_URL": "postgresql://me:hidden-word@/lbacal?host={folder}", "WAIT_S": "0"}, 1,
        "the database does not answer",
    ),
    "newer schema": ({"DATABASE_URL": "{folder}/newer.sqlite"}, 1, "newer than this version of lbacal knows"),
    "empty database": ({"DATABASE_URL": "{folder}/empty.sqlite"}, 1, "run `lbacal db upgrade`"),
    "misspelt name": (
        {"DATABASE_URL": "{folder}/empty.sqlite", "INSTRUMNET": "lofar-superterp"}, 2,
        "INSTRUMNET: expected a name such as LBACAL_INSTRUMENT",
    ),
    "absent sky": ({"DATABASE_URL": "{folder}/x.sqlite", "SKY_POWER": "{folder}/nowhere.json"}, 2, "nowhere.json"),
    "absent instrument": (
        {"DATABASE_URL": "{folder}/x.sqlite", "INSTRUMENT": "{folder}/nowhere.json"}, 2, "nowhere.json",
    ),
}  # fmt: skip
NOT_CONCERNED = {
    "absent sky": {CHECK, UPGRADE, LIST},
    "absent instrument": {CHECK, UPGRADE, LIST},
    "newer schema": {LIST},
    "empty database": {UPGRADE, ("serve", "--port", "1")},  # which make the tables
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, sqlite_template: Path) -> Path:
    """Databases that are broken, each in a way of its own, and one that is whole."""
    made = tmp_path_factory.mktemp("world")
    (made / "file").touch()
    (made / "garbage.sqlite").write_bytes(b"no database at all, " * 500)
    (made / "half.sqlite").write_bytes(sqlite_template.read_bytes()[:9000])
    for name in ("x.sqlite", "newer.sqlite"):
        shutil.copy(sqlite_template, made / name)
    with closing(sqlite3.connect(made / "newer.sqlite")) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    return made


RUN_ALL = """
import contextlib, io, json, os, sys
from lbacal.cli.main import main

for world, (settings, commands) in json.loads(sys.argv[1]).items():
    os.environ.update(settings)
    for arguments in commands:
        sys.argv = ["lbacal", *arguments]
        out, err, code = io.StringIO(), io.StringIO(), 0
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
            except SystemExit as end:
                code = end.code
        print(json.dumps([world, arguments, code, out.getvalue(), err.getvalue()]))
    for name in settings:
        del os.environ[name]
"""


@pytest.fixture(scope="module")
def ended(folder: Path, tmp_path_factory: pytest.TempPathFactory, repository: Path) -> dict[str, list[Ended]]:
    """How all commands that are concerned end in each world; one process runs them, to start one takes seconds."""
    asked = {}
    for world, (settings, _, _) in WORLDS.items():
        filled = {f"LBACAL_{name}": value.format(folder=folder) for name, value in settings.items()}
        asked[world] = filled, [one for one in COMMANDS if one not in NOT_CONCERNED.get(world, ())]
    done = subprocess.run(
        [sys.executable, "-c", RUN_ALL, json.dumps(asked)], env=environment_of({}) | {"PYTHONPATH": str(repository)},
        cwd=tmp_path_factory.mktemp("here"), capture_output=True, text=True, check=False, timeout=900,
    )  # fmt: skip
    found: dict[str, list[Ended]] = {world: [] for world in WORLDS}
    for world, arguments, *rest in (json.loads(line) for line in done.stdout.splitlines()):
        found[world].append((tuple(arguments), *rest))
    assert {world: [one[0] for one in found[world]] for world in WORLDS} == {
        world: commands for world, (_, commands) in asked.items()
    }, done.stderr
    return found


def environment_of(settings: dict[str, str]) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("LBACAL_")}
    return kept | {f"LBACAL_{name}": value for name, value in settings.items()}


def run(arguments: tuple[str, ...], settings: dict[str, str], cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lbacal", *arguments]
    environment = environment_of(settings)
    return subprocess.run(command, env=environment, cwd=cwd, capture_output=True, text=True, check=False, timeout=900)


@pytest.mark.long
@pytest.mark.parametrize("world", WORLDS)
def test_a_broken_world_is_one_sentence(world: str, ended: dict[str, list[Ended]]) -> None:
    _, code, sentence = WORLDS[world]
    for arguments, found, out, err in ended[world]:
        assert (found, out) == (code, ""), (arguments, err)
        assert sentence in err.splitlines()[-1], arguments
        assert "Traceback" not in err
        assert "hidden-word" not in err


@pytest.mark.long
def test_a_dropped_table_is_seen_by_the_check(tmp_path: Path, sqlite_template: Path) -> None:
    path = shutil.copy(sqlite_template, tmp_path / "x.sqlite")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE drift_year")
    said = run(("db", "check"), {"DATABASE_URL": str(path)}, tmp_path)
    assert said.returncode == 1
    assert "the database differs from its schema in" in said.stderr
    assert "drift_year" in said.stderr


@pytest.mark.long
def test_a_command_waits_for_a_database_that_is_still_starting(postgres: str, tmp_path: Path) -> None:
    """A proxy socket that appears later stands for a server that is booting."""
    said = run(("db", "upgrade"), {"DATABASE_URL": f"postgresql://me@/x?host={tmp_path}", "WAIT_S": "1"}, tmp_path)
    assert said.returncode == 1
    first, last = said.stderr.splitlines()
    assert first == "lbacal: the database does not answer; waiting for it up to 1 s"
    assert last.startswith("lbacal: the database does not answer: ")
    assert postgres


@pytest.mark.long
def test_a_database_that_a_server_does_not_have_is_one_sentence(postgres: str, tmp_path: Path) -> None:
    url = postgres.replace("/postgres?", "/nowhere?")
    for arguments in (CHECK, UPGRADE, LIST):
        said = run(arguments, {"DATABASE_URL": url, "WAIT_S": "0"}, tmp_path)
        assert said.returncode == 1
        assert "Traceback" not in said.stderr
        assert "nowhere" in said.stderr.splitlines()[-1]


@pytest.mark.long
def test_upgrades_at_once_all_succeed(postgres: str, tmp_path: Path) -> None:
    with psycopg.connect(postgres, autocommit=True) as connection:
        connection.execute("CREATE DATABASE at_once")
    for url in (postgres.replace("/postgres?", "/at_once?"), str(tmp_path / "at_once.sqlite")):
        command = [sys.executable, "-m", "lbacal", "db", "upgrade"]
        started = [
            subprocess.Popen(
                command, env=os.environ | {"LBACAL_DATABASE_URL": url}, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            for _ in range(4)
        ]
        said = [process.communicate() for process in started]
        assert [process.returncode for process in started] == [0] * 4, said
    with psycopg.connect(postgres, autocommit=True) as connection:
        connection.execute("DROP DATABASE at_once WITH (FORCE)")


@pytest.mark.long
def test_every_line_of_a_server_is_json_and_holds_no_key(tmp_path: Path) -> None:
    port, log = find_free_port(), tmp_path / "log"
    environment = {"LBACAL_DATABASE_URL": str(tmp_path / "x.sqlite"), "LBACAL_POLL_S": "0.2"}
    address = f"http://127.0.0.1:{port}"
    with running(Process(environment, log, "serve", "--port", str(port))):
        wait_until(lambda: is_ready(address), "the server and its worker")
        key = run_command(environment, "keys", "create", "--scope", "read").splitlines()[-1]
        told = get(f"{address}/v1/jobs?limit=7", headers={"Authorization": f"Bearer {key}", "X-Request-ID": "q1"})
        assert told.headers["x-request-id"] == "q1"
        state = get(f"{address}/v1/status").json()
    assert sorted(one["kind"] for one in state["processes"]) == ["api", "scheduler", "worker"]
    text = log.read_text()
    lines = [json.loads(line) for line in text.splitlines() if not line.startswith("lbacal serves ")]
    (line,) = [one for one in lines if one.get("request") == "q1"]
    assert (line["event"], line["path"], line["status"], line["caller"]) == ("request", "/v1/jobs", 200, "key 1")
    assert key not in text
    assert "limit=7" not in text


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


def commands_of(group: typer.Typer) -> dict[str, typer.core.TyperCommand]:
    add_commands()
    return dict(typer.main.get_command(group).commands)  # type: ignore[attr-defined]


def test_every_command_has_help_with_an_example() -> None:
    commands = commands_of(app)
    assert {"fit", "serve"} <= set(commands)
    single = {name: one for name, one in commands.items() if name not in ("db", "keys")}
    for group in ("db", "keys"):
        single |= {f"{group} {name}": one for name, one in commands[group].commands.items()}
    assert [name for name, one in single.items() if not re.search(rf"Example: .*lbacal {name}", one.help or "")] == []


def test_the_client_knows_which_commands_other_wheels_add() -> None:
    """Where a wheel is not installed, the client promises its commands, and says what to install."""
    for extra, package in (("server", "service."), ("paper", "lbacal_paper.")):
        first = {
            name: next(iter(getattr(one, "commands", {"": one}).values())) for name, one in commands_of(app).items()
        }
        added = [name for name, one in first.items() if one.callback.__module__.startswith(package)]
        assert sorted(added) == sorted(ADDED[extra])


def test_the_entry_points_add_their_commands_to_this_app() -> None:
    found = entry_points(group=ENTRY_POINTS)
    assert found.names == set(ADDED)
    assert {one.load().app for one in found} == {app}


@pytest.mark.parametrize(
    ("name", "value", "expected", "found"),
    [
        ("DATABASE_URL", "mysql://me:hidden-word@host/lbacal", "a file, or postgresql://user@host/name", "'mysql://...'"),
        (
            "DATABASE_URL", "postgresql://me:hidden-word@host:port/lbacal",
            "a number as port in postgresql://user@host:port/name", "'postgresql://...'",
        ),
        ("DATABASE_URL", "", "a file, or postgresql://user@host/name", "''"),
        ("GATE_ERROR", "inf", "a finite number", "'inf'"),
        ("WAIT_S", "soon://or later", "a valid number, unable to parse string as a number", "'soon://or later'"),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_named_with_what_it_is_and_a_database_without_its_password(
    name: str, value: str, expected: str, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"LBACAL_{name}", value)
    with pytest.raises(BadInputError) as told:
        read_settings()
    assert str(told.value) == f"LBACAL_{name}: expected {expected}, found {found}"


def test_a_child_ends_well_once_its_input_is_closed_and_not_while_it_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    heard, ended = [b"a line", b"another", b""], list[int]()
    monkeypatch.setattr(background.os, "read", lambda _descriptor, _most: heard.pop(0))
    monkeypatch.setattr(background.os, "_exit", ended.append)
    background._end_with_parent()
    assert (heard, ended) == ([], [0])
