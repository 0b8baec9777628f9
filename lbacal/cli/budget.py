"""`lbacal budget`: how far C may be off and why, as a table and as a figure."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.options import InstrumentName, Json, Since, SkyPowerFile, SpectraFiles, Stations, Until, Year
from lbacal.cli.outputs import progress, require_outputs, save_each, show_result
from lbacal.selection import find_spectra_files, parse_selection, read_selected


def budget(
    spectra: SpectraFiles,
    instrument: InstrumentName,
    sky_power: SkyPowerFile = None,
    sky: Annotated[
        str, typer.Option(help="Error of the sky: paper (20 %), models (seven models, 12 %), measured (absolute).")
    ] = "models",
    since: Since = None,
    until: Until = None,
    year: Year = None,
    station: Stations = None,
    left_open: Annotated[
        str | None,
        typer.Option(help="What an investigation of these data leaves open: R.json, or R.json#n where n is adopted."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Terms with their vectors (JSON).")] = None,
    plot: Annotated[Path | None, typer.Option(help="Terms stacked against frequency (PNG, PDF or SVG).")] = None,
    as_json: Json = False,
) -> None:
    """Print how far C may be off, term by term as in Table 1 of the paper; every term is a refit of these spectra.

    Example: lbacal budget spectra.h5 --instrument lofar-superterp --sky measured --plot budget.png
    """
    from lbacal.analysis.budget import budget as make_budget

    selection = parse_selection(since, until, year, station)
    files = find_spectra_files(spectra)
    inputs = {"--instrument": instrument, "--sky-power": sky_power}
    outputs = {"--report": report, "--plot": plot}
    require_outputs(outputs, {**inputs, **{f"SPECTRA {file}": file for file in files}})
    with progress() as tell:
        measured = read_selected(files, selection, time.time(), tell)
        found = make_budget(measured, instrument, sky_power, sky, left_open, tell=tell)
    show_result(found, [*found.lines, found.title], as_json=as_json)
    save_each(found, outputs)
