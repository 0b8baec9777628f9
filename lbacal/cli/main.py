"""The command `lbacal`: gathered from the files beside it; failures become one sentence and an exit code.

The wheels `lbacal-server` and `lbacal-paper` bring commands of their own and name the module of these as an entry
point. Where a wheel or an extra is not installed, its commands say so before they do anything.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache, wraps
from importlib.metadata import entry_points, version
from importlib.util import find_spec
from typing import Annotated, Any

import typer
import typer.core

from lbacal import FIT
from lbacal.cli.analysis import audit, budget, fit, investigate, lst_curve, predict
from lbacal.cli.calibration_tables import check_table, export
from lbacal.cli.causes import causes
from lbacal.cli.client import effective, ingest, jobs, refit, sync
from lbacal.cli.ledger import abandon, adopt, alarms, models, promote, rollback, status, tag, withdraw
from lbacal.cli.life import changes, life
from lbacal.cli.sky_power import antenna_gain, sky_power
from lbacal.cli.spectra import import_, spectra
from lbacal.settings import require_known_settings
from lbacal_core.errors import BadInputError, LbacalError, MissingExtraError, UnknownNameError, UnreadableFileError

ADDED = {"server": ("serve", "scheduler", "worker", "db", "keys"), "paper": ("paper",)}
"""The commands that other wheels add, by the extra that installs them."""
ENTRY_POINTS = "lbacal.commands"
"""The group under which a wheel names, by its extra, the module that adds its commands to `app` when it is imported."""

GROUPS = {
    "C from files": ("fit", "budget", "audit", "investigate", "predict", "lst-curve", "paper"),
    "Data and models": ("spectra", "import", "sky-power", "antenna-gain", "check-table", "export", "causes"),
    "Ask a server": ("effective", "life", "status", "alarms", "jobs", "models", "ingest", "sync"),
    "Decide what is in effect": (
        "changes", "refit", "promote", "withdraw", "rollback", "tag", "adopt", "abandon",
    ),
    "Run a server": ADDED["server"],
}  # fmt: skip
"""The commands as `lbacal --help` lists them."""


class _Grouped(typer.core.TyperGroup):
    """Commands by what they are for, each with its whole first sentence."""

    def format_commands(self, _ctx: Any, formatter: Any) -> None:
        """Write a list a group."""
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, self.commands[name].get_short_help_str(limit=300)) for name in names])


app = typer.Typer(
    name="lbacal",
    cls=_Grouped,
    help="Absolute calibration of radio antennas with the Galaxy.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _needing_fit(command: Callable[..., None]) -> Callable[..., None]:
    """The command, which refuses to begin where the extra `fit` is not installed, unless a server does the work."""

    @wraps(command)
    def checked(*arguments: Any, **options: Any) -> None:
        if not options.get("stored") and not all(find_spec(name) for name in FIT):
            raise MissingExtraError(f"lbacal {_name(command)}", "fit")
        command(*arguments, **options)

    return checked


def _name(command: Callable[..., None]) -> str:
    return command.__name__.strip("_").replace("_", "-")


_COMPUTING: tuple[Callable[..., None], ...] = (
    audit, fit, budget, investigate, predict, lst_curve, sky_power, antenna_gain, spectra
)  # fmt: skip
_ASKING: tuple[Callable[..., None], ...] = (
    ingest, refit, promote, withdraw, rollback, tag, effective, jobs, status, alarms, life, sync, adopt,
    models, abandon, check_table, export,
)  # fmt: skip
for command in (*map(_needing_fit, _COMPUTING), import_, *_ASKING):
    app.command(_name(command))(command)
app.add_typer(changes, name="changes")
app.add_typer(causes, name="causes")


def _print_version(is_asked: bool) -> None:
    if is_asked:
        print(f"lbacal {version('lbacal')}")
        raise typer.Exit


@app.callback()
def options(
    _show_version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Absolute calibration of radio antennas with the Galaxy."""
    require_known_settings()


EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
_BAD_INPUT = (BadInputError, UnreadableFileError, UnknownNameError, MissingExtraError)
_BAD_REQUEST = (400, 413, 415, 422)
_BAD_USAGE: Any = typer.BadParameter.__base__
_UNUSABLE_FILES = (FileExistsError, FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)
_OF_THE_API = {
    r"GET /v1/(alarms|changes|jobs|models|tag)s? lists": r"lbacal \1 lists",
    r"\bbody\.(?:valid_)?(antenna|dipole|finding|fit|from|kind|reason|scope|since|size|station|to|until):": r"--\1:",
    r"\bgap=hold of GET /v1/calibrations/effective": "lbacal effective --gap hold",
}
"""Words of the HTTP API in the sentences of a server, as patterns, and those of the commands."""


def run() -> None:
    """Run the command: exit 0 done, 1 the work failed, 2 bad usage or bad input, never a traceback for those."""
    try:
        sys.exit(app(prog_name="lbacal", standalone_mode=False))
    except _BAD_USAGE as error:
        _tell_usage(error)
    except LbacalError as error:
        print(f"lbacal: {_say(error)}{f': {error.detail}' if error.detail else ''}", file=sys.stderr)
        is_bad_input = isinstance(error, _BAD_INPUT) or error.status in _BAD_REQUEST
        sys.exit(EXIT_BAD_INPUT if is_bad_input else EXIT_FAILED)
    except _UNUSABLE_FILES as error:
        print(f"lbacal: {error.filename}: {error.strerror}; name a file that can be used here", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except OSError as error:
        print(f"lbacal: the work failed: {error}", file=sys.stderr)
        sys.exit(EXIT_FAILED)


def _say(error: LbacalError) -> str:
    """The sentence of a failure in the words of the commands."""
    told = str(error)
    for pattern, words in _OF_THE_API.items():
        told = re.sub(pattern, words, told)
    return told


def _tell_usage(error: Any) -> None:
    """One sentence with the command that says more; a command that needs arguments and has none shows its help."""
    message = error.format_message().strip()
    if "\n" in message:
        error.show()
    else:
        command = error.ctx.command_path if error.ctx else "lbacal"
        print(f"{command}: {message[:1].lower()}{message[1:].rstrip('.')}; see {command} --help", file=sys.stderr)
    sys.exit(EXIT_BAD_INPUT)


def main() -> None:
    """Run the command."""
    add_commands()
    run()


@cache
def add_commands() -> None:
    """Add the commands of the other wheels; those of a wheel that is not installed say what to install."""
    wheels = entry_points(group=ENTRY_POINTS)
    for wheel in sorted(wheels, key=lambda one: one.name):  # not as folders of packages happen to be listed
        wheel.load()
    for extra in ADDED.keys() - wheels.names:
        for name in ADDED[extra]:
            _promise(name, extra)


def _promise(name: str, extra: str) -> None:
    """A command that is not installed: whatever it is asked, it says what to install."""

    @app.command(
        name, help=f"(needs the extra {extra})", add_help_option=False,
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
    )  # fmt: skip
    def absent() -> None:
        raise MissingExtraError(f"lbacal {name}", extra)
