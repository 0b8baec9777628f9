"""`lbacal fit`, `budget`, `audit`, `investigate`, `predict`, `lst-curve`: what `lbacal.analysis` does, from files."""

from __future__ import annotations

import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.client import wait_for
from lbacal.cli.outputs import (
    Band,
    Dask,
    InstrumentName,
    Json,
    Since,
    SkyPowerFile,
    SpectraFiles,
    Stations,
    Until,
    Year,
    progress,
    require_outputs,
    save_each,
    show_each,
    show_result,
)
from lbacal.client import Client
from lbacal.files import write_json, written_beside
from lbacal.instants import format_optional
from lbacal.selection import Selection, find_spectra_files, parse_selection, read_selected
from lbacal.with_model import HELP, read_model, report_path
from lbacal_core.errors import BadInputError

STEPS_OF_FIT = 2
"""What the progress bar counts beside the files: the fit, and the error of one event."""


Scope = StrEnum("Scope", ["array", "station", "antenna"])
"""What one curve belongs to."""


def fit(
    spectra: SpectraFiles,
    instrument: InstrumentName,
    output: Annotated[Path, typer.Option(help="Calibration table: .ecsv, .fits, .h5, .json, or .csv (rows).")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON), whatever the outcome.")],
    sky_power: SkyPowerFile = None,
    scope: Annotated[Scope, typer.Option(help="What one curve belongs to.")] = Scope.antenna,
    since: Since = None,
    until: Until = None,
    year: Year = None,
    station: Stations = None,
    with_: Annotated[str | None, typer.Option("--with", metavar="R.json[#n]", help=HELP)] = None,
    html: Annotated[Path | None, typer.Option(help="Page to write: table, figure, budget (one HTML file).")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Figure to write: C with its errors, residuals, noise, chi2 (PNG, PDF or SVG).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fit the signal chain to background spectra and write C(nu) with its errors.

    Example: lbacal fit 2014/ --instrument lofar-superterp --scope station --year 2014 --output C.ecsv --report fit.json
    --html fit.html

    Exit 0 if any curve converged, else 1; the report is written either way.
    """
    from lbacal.analysis.fit import NEXT_STEP
    from lbacal.analysis.fit import fit as fit_spectra
    from lbacal.analysis.instrument import simulation_of
    from lbacal.calibration_files import require_format

    selection = parse_selection(since, until, year, station)
    files = find_spectra_files(spectra)
    known = {"--instrument": instrument, "--sky-power": sky_power, "--with": with_ and report_path(with_)}
    require_outputs({"--output": output, "--report": report, "--html": html, "--plot": plot}, known, files)
    require_format("--output", output)
    read_model(with_).require_one_c(f"--with {with_}")
    simulation = simulation_of(instrument, sky_power)
    given = "" if sky_power is None else f" --sky-power {sky_power}"
    rerun = f"{' '.join(str(path) for path in spectra)}{selection.options} --instrument {instrument}{given}"
    steps = len(files) + STEPS_OF_FIT + (html is not None or plot is not None)
    with progress(steps) as tell:
        measured = read_selected(files, selection, time.time(), tell)
        found = fit_spectra(measured, simulation, None, scope.value, with_, tell=tell)
        with written_beside(report) as beside:
            write_json(found.report.as_dict(), beside)
        found.save(output)
        if html is not None or plot is not None:
            tell("draw")
        save_each(found, {"--plot": plot, "--html": html})
    written = " and ".join(str(path) for path in (output, report, html, plot) if path is not None)
    next_step = f"lbacal investigate {rerun} --report R.json --html R.html"
    said = [line.replace(NEXT_STEP, next_step) for line in found.lines]
    counted = f"{len(found.converged)} of {len(found.report.curves)} curves converged"
    show_result(found, [f"{counted}; wrote {written}", *said], as_json=as_json)
    if not found.converged:
        raise typer.Exit(1)


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
    outputs = {"--report": report, "--plot": plot}
    require_outputs(outputs, {"--instrument": instrument, "--sky-power": sky_power}, files)
    with progress() as tell:
        measured = read_selected(files, selection, time.time(), tell)
        found = make_budget(measured, instrument, sky_power, sky, left_open, tell=tell)
    show_result(found, [*found.lines, found.title], as_json=as_json)
    save_each(found, outputs)


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
    """Check a station: dead, insensitive or oscillating paths, exchanged dipoles, cables, clock, arms, place, unit.

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
    inputs = {"--lst-curve": lst_curve, "--sky-power": sky_power, "--with": with_ and report_path(with_)}
    outputs = {"--report": report, "--html": html}
    require_outputs(outputs, {**inputs, "--instrument": instrument}, files)
    read_model(with_)
    simulation = simulation_of(instrument or "lofar-superterp", sky_power)
    with progress() as tell:
        measured = read_lst_curve(lst_curve) if lst_curve else read_selected(files, selection, time.time(), tell)
        found = investigate_data(measured, simulation, None, with_, band, dask=read_address(dask), tell=tell)
    save_each(found, outputs)
    written = f"{found.headline}; wrote {report}{f' and {html}' if html else ''}"
    show_result(found, [written, *found.lines], as_json=as_json)


# `lbacal investigate --stored`: the service investigates what it keeps.


def investigate_stored(selection: Selection, reason: str | None, report: Path | None, *, as_json: bool) -> None:
    """Ask the server for investigations, one a station and calendar year, wait for them and print what they found."""
    if len(selection.stations) > 1:
        raise BadInputError("--station", "one beside --stored, or none for all", ", ".join(selection.stations))
    since, until = format_optional(selection.since), format_optional(selection.until)
    body = {"since": since, "until": until, "reason": reason}
    for name, value in body.items():
        if value is None:
            raise BadInputError(f"--{name}", "a value beside --stored", "nothing")
    with Client() as client:
        asked = {**body, "station": next(iter(selection.stations), None)}
        job = wait_for(client, client.send("POST", "/v1/investigations", asked)["job"])
        found = [client.get(f"/v1/investigations/{name}") for name in job["results"]]
    if report is not None and len(found) != 1:
        raise BadInputError("--report", "one station and one calendar year, which make one report", str(len(found)))
    show_each(found, print_investigation, "no investigations", as_json=as_json)
    if report is not None:
        with written_beside(report) as beside:
            write_json(found[0]["report"], beside)
    if job["state"] != "done":
        print(f"job {job['job']} is {job['state']}: {job['error']}", file=sys.stderr)
        raise typer.Exit(1)


def print_investigation(one: dict[str, Any]) -> None:
    """Print the verdict of a stored investigation, and its findings with the numbers by which they are adopted."""
    window = f"{one['since'][:10]} to {one['until'][:10]}"
    print(f"{one['station']}, {window}: {one['report']['verdict']}; investigation {one['id'][:12]}")
    for number, finding in enumerate(one["report"]["findings"]):
        print(f"  #{number} {finding['significance_sigma']:.1f} sigma: {finding['sentence']}")
    if one["report"]["unexplained"]:
        left = one["report"]["unexplained"]
        print(f"  {left['description']}")
        if left.get("in_words"):
            print(f"  in words: {left['in_words']}")


def predict(
    station: Annotated[str, typer.Option(help="Station.")],
    antenna: Annotated[int, typer.Option(help="Antenna.", min=0)],
    dipole: Annotated[str, typer.Option(help="Letter of the dipole.")],
    at: Annotated[str, typer.Option(help="When, ISO 8601, UTC.")],
    output: Annotated[
        Path | None, typer.Option(help="Prediction to write: .h5, .json, .ecsv, .fits, .csv, .html, .png.")
    ] = None,
    temperature: Annotated[float | None, typer.Option(help="Outside temperature, deg C.")] = None,
    realisations: Annotated[int, typer.Option(help="How many noisy events to draw (.h5).", min=0)] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the events.")] = 1,
    simulation: Annotated[
        str | None, typer.Option(help="Instrument (name or JSON file) alone, instead of what is in effect.")
    ] = None,
    with_: Annotated[
        str | None, typer.Option("--with", metavar="R.json[#n]", help=f"{HELP} With --simulation.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Predict the spectrum of a path, what it is made of, SEFD, and noisy events, from the calibration in effect.

    Example: lbacal predict --station CS002 --antenna 17 --dipole X --at 2014-05-01T12:00:00Z --output P.h5
    """
    from lbacal.analysis.predict import predict as predict_path
    from lbacal.analysis.predict import write_prediction

    require_outputs({"--output": output}, {"--simulation": simulation, "--with": with_ and report_path(with_)})
    ending = "" if output is None else output.suffix.lower()
    if realisations and ending not in (".h5", ".hdf5"):
        raise BadInputError("--realisations", "an --output that ends in .h5 or .hdf5", ending or "no ending")
    if with_ and simulation is None:
        raise BadInputError("--with", "--simulation beside it: what is in effect has its causes", "none")
    where: dict[str, Any] = {"station": station, "antenna": antenna, "dipole": dipole}
    found = predict_path(simulation, at=at, **where, temperature=temperature, with_=with_)
    if output is not None and realisations:
        with written_beside(output) as beside:
            write_prediction(found.content, beside, found.draw_events(realisations, seed))
    elif output is not None:
        found.save(output)
    written = [] if output is None else [f"wrote {output}"]
    show_result(found, [found.title, *found.lines, *written], as_json=as_json)


def lst_curve(
    curve: Annotated[Path, typer.Argument(help="LST curve (CSV: lst_h, x_db, y_db, error_db).")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON).")],
    sky_power: SkyPowerFile = None,
    instrument: Annotated[str, typer.Option(help="Instrument: a name or a JSON file.")] = "lofar-superterp",
    band: Band = (30.0, 80.0),
    plot: Annotated[Path | None, typer.Option(help="Figure to write (PNG, PDF or SVG, by its ending).")] = None,
    as_json: Json = False,
) -> None:
    """Compare band power against sidereal time, measured and simulated.

    Nothing is fitted but, for each dipole, an offset and the share of electronic noise in the power (0 to 1).

    Example: lbacal lst-curve measured.csv --report lst.json --plot lst.png
    """
    from lbacal.analysis.lst_curve import lst_curve as compare

    outputs = {"--report": report, "--plot": plot}
    require_outputs(outputs, {"CURVE": curve, "--instrument": instrument, "--sky-power": sky_power})
    found = compare(curve, instrument, sky_power, band)
    save_each(found, outputs)
    written = f"wrote {report}" + (f" and {plot}" if plot else "")
    show_result(found, [*found.lines, written], as_json=as_json)
