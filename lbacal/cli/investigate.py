"""`lbacal investigate`: what the simulation gets wrong in these data."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.options import Dask, Json, Since, SkyPowerFile, Until, Year
from lbacal.selection import Selection, find_spectra_files, parse_selection, read_selected
from lbacal.with_model import HELP, read_model, report_path


def investigate(
    spectra: Annotated[
        list[Path] | None, typer.Argument(help="Spectra files (HDF5, lbacal-spectra-1), or folders of them.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Report to write (JSON); with --stored it is kept there and need not be.")
    ] = None,
    lst_curve: Annotated[
        Path | None, typer.Option(help="Ask a band-averaged LST curve instead (CSV: lst_h, x_db, y_db, error_db).")
    ] = None,
    instrument: Annotated[
        str | None,
        typer.Option(help="Instrument: a name or a JSON file; lofar-superterp for an LST curve unless given."),
    ] = None,
    sky_power: SkyPowerFile = None,
    band: Annotated[tuple[float, float], typer.Option(help="First and last channel of the LST curve's band, MHz.")] = (
        30.0,
        80.0,
    ),
    html: Annotated[Path | None, typer.Option(help="The report as a page with its figures (HTML).")] = None,
    with_: Annotated[str | None, typer.Option("--with", metavar="R.json[#n]", help=HELP)] = None,
    stored: Annotated[bool, typer.Option("--stored", help="Let the service investigate the spectra it keeps.")] = False,
    since: Since = None,
    until: Until = None,
    year: Year = None,
    station: Annotated[
        list[str] | None, typer.Option(help="Station to use; may be given several times, with --stored once.")
    ] = None,
    dask: Dask = None,
    reason: Annotated[str | None, typer.Option(help="Why the stored spectra are investigated; it is kept.")] = None,
    as_json: Json = False,
) -> None:
    """Find what the simulation gets wrong: name the cause, extend the model, measure the gain.

    Example: lbacal investigate 2014/ --instrument lofar-superterp --station CS002 --report R.json --html R.html

    The service does it with its stored spectra, one report a station and calendar year:
    lbacal investigate --stored --since 2014-01-01 --until 2015-01-01 --reason "new map"
    """
    selection = parse_selection(since, until, year, station)
    if stored:
        from lbacal.cli.stored import investigate_stored

        if spectra or lst_curve is not None or with_ is not None:
            raise typer.BadParameter(
                "--stored names spectra and model: no file, no --lst-curve and no --with beside it"
            )
        investigate_stored(selection, reason, report, as_json=as_json)
        return
    if report is None:
        raise typer.BadParameter("name the report to write with --report")
    from lbacal.analysis.instrument import simulation_of
    from lbacal.analysis.investigate import investigate as investigate_data
    from lbacal.cli.outputs import progress, require_outputs, save_each, show_result
    from lbacal.engine import read_address
    from lbacal_core.lstcurve.curve import read_lst_curve

    if (not spectra) == (lst_curve is None):
        raise typer.BadParameter("name spectra files or --lst-curve, one of the two")
    if spectra and instrument is None:
        raise typer.BadParameter("spectra need --instrument, a name such as lofar-superterp or a JSON file")
    if lst_curve is not None and (with_ is not None or selection != Selection()):
        raise typer.BadParameter(
            "--with, --since, --until, --year and --station belong to spectra, not to an LST curve"
        )
    files = find_spectra_files(spectra or [])
    inputs: dict[str, str | Path | None] = {f"SPECTRA {file}": file for file in files}
    inputs |= {"--lst-curve": lst_curve, "--sky-power": sky_power}
    inputs["--with"] = None if with_ is None else report_path(with_)
    outputs = {"--report": report, "--html": html}
    require_outputs(outputs, {**inputs, "--instrument": instrument})
    read_model(with_)
    simulation = simulation_of(instrument or "lofar-superterp", sky_power)
    with progress() as tell:
        measured = read_lst_curve(lst_curve) if lst_curve else read_selected(files, selection, time.time(), tell)
        found = investigate_data(measured, simulation, None, with_, band, dask=read_address(dask), tell=tell)
    save_each(found, outputs)
    written = f"{found.verdict}; wrote {report}{f' and {html}' if html else ''}"
    show_result(found, [written, *found.lines], as_json=as_json)
