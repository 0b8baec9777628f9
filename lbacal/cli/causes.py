"""`lbacal causes`: name what a report describes in words, so that it is looked for like a cause of the catalogue."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import Json, show_each
from lbacal.files import written_beside
from lbacal.settings import causes_file
from lbacal.with_model import read_report
from lbacal_core.errors import BadInputError, MissingExtraError

causes = typer.Typer(invoke_without_command=True)
File = Annotated[Path | None, typer.Option("--file", help="File of the causes; LBACAL_CAUSES unless given.")]


@causes.callback()
def list_causes(context: typer.Context, file: File = None, as_json: Json = False) -> None:
    """List the causes of this installation, or name another one: sentences of reports, beside the catalogue.

    Example: lbacal causes
    """
    if find_spec("scipy") is None:
        raise MissingExtraError("lbacal causes", "fit")
    if context.invoked_subcommand is None:
        from lbacal_core.causes.catalogue import read_own_causes

        found = [{"cause": one.identifier, "meaning": one.meaning} for one in read_own_causes(_required(file))]
        show_each(found, lambda one: print(f"{one['cause']}: {one['meaning']}"), "no causes", as_json=as_json)


@causes.command()
def add(
    report: Annotated[
        str, typer.Argument(metavar="R.json#n", help="Report; #unexplained, or the number of a finding.")
    ],
    name: Annotated[str, typer.Option(help="Name by which reports call it: lower-case letters, digits and _.")],
    file: File = None,
) -> None:
    """Name the sentence of a report: every investigation that reads the file looks for it, with a size of its own.

    Example: lbacal causes add R.json#unexplained --name workshop --file causes.json
    """
    from lbacal_core.causes.catalogue import NamedSentence, find_sentence, own_causes_text, read_own_causes

    path = _required(file)
    content, number = read_report(report, "lbacal causes add")
    made, known = (
        NamedSentence.of(name, find_sentence(content, number)),
        read_own_causes(path if path.exists() else None),
    )
    if name in {one.identifier for one in known}:
        raise BadInputError("--name", f"a name that {path} does not have", name)
    with written_beside(path) as beside:
        beside.write_text(own_causes_text([*known, made]), encoding="utf-8")
    print(f"{name}: {made.meaning}; in {path}")


def _required(file: Path | None) -> Path:
    path = file or causes_file()
    if path is None:
        raise BadInputError("--file", "a file for the causes of this installation, or LBACAL_CAUSES", "neither")
    return path
