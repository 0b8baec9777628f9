"""The command `lbacal`: one subcommand a file; this one gathers them and turns failures into one sentence and an exit code."""

from __future__ import annotations

import sys

import typer

from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError, UnreadableFileError

app = typer.Typer(
    name="lbacal",
    help="Absolute calibration of radio antennas with the Galaxy.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
_BAD_INPUT = (BadInputError, UnreadableFileError, UnknownNameError)


def main() -> None:
    """Run the command: exit 0 done, 1 the work failed, 2 bad usage or bad input, never a traceback for those."""
    try:
        app()
    except LbacalError as error:
        print(f"lbacal: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT if isinstance(error, _BAD_INPUT) else EXIT_FAILED)


if __name__ == "__main__":
    main()
