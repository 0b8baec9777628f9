"""`lbacal fit`: calibration curves from spectra files, without a database."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.options import InstrumentName, Json, Since, SkyPowerFile, SpectraFiles, Stations, Until, Year
from lbacal.cli.outputs import progress, require_outputs, save_each, show_result
from lbacal.files import written_beside
from lbacal.selection import find_spectra_files, parse_selection, read_selected
from lbacal.with_model import HELP, read_model, report_path

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
    from lbacal.calibration_files import require_format
    from lbacal_core.curves.curves import write_fit_report
    from lbacal_core.simulation.simulation import Simulation

    selection = parse_selection(since, until, year, station)
    files = find_spectra_files(spectra)
    known = {"--instrument": instrument, "--sky-power": sky_power, "--with": with_ and report_path(with_)}
    require_outputs(
        {"--output": output, "--report": report, "--html": html, "--plot": plot},
        {**known, **{f"SPECTRA {file}": file for file in files}},
    )
    require_format("--output", output)
    read_model(with_).require_one_c(f"--with {with_}")
    simulation = Simulation.load(instrument, sky_power)
    given = "" if sky_power is None else f" --sky-power {sky_power}"
    rerun = f"{' '.join(str(path) for path in spectra)}{selection.options} --instrument {instrument}{given}"
    steps = len(files) + STEPS_OF_FIT + (html is not None or plot is not None)
    with progress(steps) as tell:
        measured = read_selected(files, selection, time.time(), tell)
        found = fit_spectra(measured, simulation, None, scope.value, with_, tell=tell)
        with written_beside(report) as beside:
            write_fit_report(found.report, beside)
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
