"""`lbacal audit`: what is wrong with a station, in seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.options import InstrumentName, Json
from lbacal.cli.outputs import progress, require_outputs, save_each, show_result

EXIT_WRONG = 3
"""Exit code when something is wrong with a station: the work was done, so neither 1 nor 2."""


def audit(
    data: Annotated[Path, typer.Argument(help="Spectra file, or data in any format of `lbacal import`.")],
    instrument: InstrumentName,
    report: Annotated[Path | None, typer.Option(help="Report to write (JSON).")] = None,
    html: Annotated[Path | None, typer.Option(help="Page to write, with figures.")] = None,
    sky: Annotated[str | None, typer.Option(help="Sky model that a working station sees: a name, or a file.")] = None,
    antenna: Annotated[str | None, typer.Option(help="Antenna model: a name, or a file.")] = None,
    average: Annotated[float, typer.Option(help="Seconds to average, for data that are no spectra file.")] = 900.0,
    as_json: Json = False,
) -> None:
    """Check a station: dead, deaf, oscillating or outlying paths, exchanged dipoles, cables, clock, arms, place, unit.

    Example: lbacal audit S.h5 --instrument lofar-superterp --report audit.json --html audit.html

    Minutes of data find what differs from antenna to antenna; clock, arms, place and unit need hours of sidereal
    time. Exit 0 if nothing is wrong, 3 if something is.
    """
    from lbacal.analysis.audit import audit as audit_data

    outputs = {"--report": report, "--html": html}
    require_outputs(outputs, {"DATA": data, "--instrument": instrument})
    with progress() as tell:
        found = audit_data(data, instrument, sky, antenna, average, tell=tell)
    show_result(found, [*found.lines, found.title], as_json=as_json)
    save_each(found, outputs)
    if found.wrong:
        raise typer.Exit(EXIT_WRONG)
