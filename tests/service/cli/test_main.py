from __future__ import annotations

import re
from importlib.metadata import entry_points

import typer

from lbacal.cli.main import SERVER, SERVER_COMMANDS
from service.cli.main import app


def commands_of(group: typer.Typer) -> dict[str, typer.core.TyperCommand]:
    return dict(typer.main.get_command(group).commands)  # type: ignore[attr-defined]


def test_every_command_has_help_with_an_example() -> None:
    commands = commands_of(app)
    assert {"fit", "serve"} <= set(commands)
    single = {name: one for name, one in commands.items() if name not in ("db", "keys")}
    for group in ("db", "keys"):
        single |= {f"{group} {name}": one for name, one in commands[group].commands.items()}
    assert [name for name, one in single.items() if not re.search(rf"Example: .*lbacal {name}", one.help or "")] == []


def test_the_client_knows_which_commands_the_server_adds() -> None:
    """Where the server is not installed, the client promises these, and says what to install."""
    added = [name for name, one in commands_of(app).items() if _module_of(one).startswith("service.")]
    assert sorted(added) == sorted(SERVER)


def _module_of(command: typer.core.TyperCommand) -> str:
    inner = next(iter(getattr(command, "commands", {"": command}).values()))
    return str(inner.callback.__module__)


def test_the_entry_point_of_the_server_is_this_module() -> None:
    (found,) = entry_points(group=SERVER_COMMANDS)
    assert found.load().app is app
