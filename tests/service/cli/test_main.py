from __future__ import annotations

import re
from importlib.metadata import entry_points

import typer

from lbacal.cli.main import ADDED, ENTRY_POINTS, add_commands, app


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
        added = [name for name, one in commands_of(app).items() if _module_of(one).startswith(package)]
        assert sorted(added) == sorted(ADDED[extra])


def _module_of(command: typer.core.TyperCommand) -> str:
    inner = next(iter(getattr(command, "commands", {"": command}).values()))
    return str(inner.callback.__module__)


def test_the_entry_points_add_their_commands_to_this_app() -> None:
    found = entry_points(group=ENTRY_POINTS)
    assert found.names == set(ADDED)
    assert {one.load().app for one in found} == {app}
