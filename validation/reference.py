"""`./dev docs`: the reference pages that follow from the code: commands, settings and causes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

import typer
from pydantic_core import PydanticUndefined

from lbacal.cli.main import add_commands, app
from lbacal.settings import CLIENT_SETTINGS
from lbacal_core.causes.cable import AntennaCause
from lbacal_core.causes.catalogue import ANTENNA_CAUSES, CAUSES
from lbacal_core.causes.cause import SCOPES, Cause
from service.config import Settings

DOCS = Path(__file__).parents[1] / "docs"

_COMMANDS = """# Commands
Written by `./dev docs` from the commands themselves: do not edit. `lbacal COMMAND --help` says what each option means
and what it is by default, and which are required; what answers has `--json`. Every command exits with 0 when it is
done, 1 when the work failed, and 2 on bad usage or bad input, with one sentence on standard error. [How to
install](how-to/install.md) says which need an extra.
"""
_SETTINGS = """# Settings
Written by `./dev docs` from `service/config.py` and `lbacal/settings.py`: do not edit. Each setting is an environment
variable; one that begins with `LBACAL_` and is not in this list is refused by every command.

"""
_CAUSES = """# Causes
Written by `./dev docs` from `lbacal_core/causes/`: do not edit. Mechanisms that may make a simulation wrong, with
the unit of their size (*amount*: times its course), the targets that they affect, the axes along which they vary,
and how other means could confirm them. [How it searches](explanation/what-the-simulation-gets-wrong.md), [how to add
one](how-to/add-a-cause.md).
"""


def describe_commands() -> str:
    """Write the content of docs/commands.md."""
    add_commands()
    return _COMMANDS + "".join(_describe(["lbacal"], typer.main.get_command(app)))


def describe_settings() -> str:
    """Write the content of docs/settings.md."""
    rows = {}
    for name, field in Settings.model_fields.items():
        default = "required" if field.default is PydanticUndefined else field.default
        rows[f"LBACAL_{name.upper()}"] = (field.description or "", "none" if default is None else str(default))
    rows |= {name: row for name, row in CLIENT_SETTINGS.items() if name not in rows}
    return _SETTINGS + "".join(f"- `{name}`: {text} (={default})\n" for name, (text, default) in rows.items())


def describe_causes() -> str:
    """Write the content of docs/causes.md."""
    causes: list[Cause | AntennaCause] = sorted((*CAUSES, *ANTENNA_CAUSES), key=lambda one: one.identifier)
    needs: dict[str, list[str]] = {}
    for cause in causes:
        needs.setdefault(cause.needs, []).append(f"`{cause.identifier}`")
    hidden = "".join(f"- {', '.join(names)}: {need}.\n" for need, names in needs.items() if need)
    texts = "".join(_describe_cause(cause) for cause in causes)
    return f"{_CAUSES}{texts}\n## Where a cause cannot be shown\n{hidden}"


def _describe_cause(cause: Cause | AntennaCause) -> str:
    kind = type(cause)
    is_one_of_several = sum(type(one) is kind for one in (*CAUSES, *ANTENNA_CAUSES)) > 1
    says = f"{cause.meaning[0].upper()}{cause.meaning[1:]}" if is_one_of_several else _first_line(kind).rstrip(".")
    does = f" {_first_line(cause.does or cause.act)}" if isinstance(cause, Cause) else ""
    tried = "" if kind.templates is Cause.templates else _first_line(kind.templates)
    is_one = tried.startswith("One")  # says no more than what it needs, which stands at the end of the page
    targets = "any" if set(cause.scopes) == set(SCOPES) else ", ".join(cause.scopes)
    found = (
        f"Targets: {targets}. Axes: {', '.join(cause.axes)}.",
        f"Templates: {tried}" if tried and not is_one else "",
        f"Confirm: {cause.confirm}.",
    )
    return f"\n## {cause.identifier}\n{says} ({cause.unit}).{does}\n\n{' '.join(filter(None, found))}\n"


def _first_line(thing: Any) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def _describe(path: list[str], command: Any) -> Iterator[str]:
    """One section a command, those of a group after its own; a group that does nothing by itself has none."""
    if len(path) > 1 and not getattr(command, "invoke_without_command", True):
        for name, one in command.commands.items():
            yield from _describe([*path, name], one)
        return
    arguments = [f"{p.name.upper()}{'...' if p.nargs < 0 else ''}" for p in command.params if _is_argument(p)]
    yield f"\n## `{' '.join([*path, *arguments])}`\n"
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        text = " ".join(paragraph.split())
        example = text.removeprefix("Example: ")
        if example == text:
            yield f"{text}\n\n"
        elif " -" in example:  # without an option it says no more than the heading
            yield f"`{example}`\n\n"
    shown = set(re.findall(r"--[a-z-]+", command.help or ""))
    others = [one for one in command.params if not _is_argument(one) and one.name not in OF_ALL]
    options = ", ".join(_name_option(one) for one in others if not shown & set(one.opts))
    yield f"Also {options}\n" if options else ""
    for name, one in getattr(command, "commands", {}).items():
        yield from _describe([*path, name], one)


OF_ALL = ("help", "install_completion", "show_completion", "as_json")
"""Options that say nothing of a command."""


def _is_argument(parameter: Any) -> bool:
    return not parameter.opts[0].startswith("-")


def _name_option(parameter: Any) -> str:
    """The option, and its choices where it has some."""
    kind = parameter.type_descriptor.annotation
    is_choice = isinstance(kind, type) and issubclass(kind, StrEnum)
    choices = f" {'|'.join(kind)}" if is_choice else ""
    return f"`{' / '.join(parameter.opts + parameter.secondary_opts)}{choices}`"


def main() -> None:
    """Write the pages."""
    (DOCS / "causes.md").write_text(describe_causes(), encoding="utf-8")
    (DOCS / "commands.md").write_text(describe_commands(), encoding="utf-8")
    (DOCS / "settings.md").write_text(describe_settings(), encoding="utf-8")


if __name__ == "__main__":
    main()
