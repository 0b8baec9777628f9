"""The command `lbacal`: one subcommand a file, gathered here; failures become one sentence and an exit code."""

from __future__ import annotations

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError, UnreadableFileError
from service.cli.client import effective, ingest, jobs, refit
from service.cli.database import db, keys
from service.cli.fit import fit
from service.cli.investigate import investigate
from service.cli.lst_curve import lst_curve
from service.cli.processes import scheduler, worker
from service.cli.serve import serve
from service.cli.sky_power import sky_power
from service.cli.spectra import spectra
from service.cli.status import status
from service.errors import UnavailableError

app = typer.Typer(
    name="lbacal",
    help="Absolute calibration of radio antennas with the Galaxy.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

app.command()(fit)
app.command()(investigate)
app.command()(lst_curve)
app.command(name="sky-power")(sky_power)
app.command()(spectra)
for command in (serve, scheduler, worker, ingest, refit, effective, jobs, status):
    app.command()(command)
app.add_typer(db, name="db")
app.add_typer(keys, name="keys")


def _print_version(is_asked: bool) -> None:
    if is_asked:
        print(f"lbacal {version('lbacal')}")
        raise typer.Exit


@app.callback()
def options(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Absolute calibration of radio antennas with the Galaxy."""


EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
_BAD_INPUT = (BadInputError, UnreadableFileError, UnknownNameError)
_BAD_REQUEST = (400, 413, 415, 422)
_UNUSABLE_FILES = (FileExistsError, FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)


def main() -> None:
    """Run the command: exit 0 done, 1 the work failed, 2 bad usage or bad input, never a traceback for those."""
    try:
        app()
    except LbacalError as error:
        detail = f": {error.detail}" if isinstance(error, UnavailableError) and error.detail else ""
        print(f"lbacal: {error}{detail}", file=sys.stderr)
        is_bad_input = isinstance(error, _BAD_INPUT) or error.status in _BAD_REQUEST
        sys.exit(EXIT_BAD_INPUT if is_bad_input else EXIT_FAILED)
    except _UNUSABLE_FILES as error:
        print(f"lbacal: {error.filename}: {error.strerror}; name a file that can be used here", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except OSError as error:
        print(f"lbacal: the work failed: {error}", file=sys.stderr)
        sys.exit(EXIT_FAILED)


if __name__ == "__main__":
    main()
