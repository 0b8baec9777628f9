"""`lbacal budget`: how far C may be off and why, as a table and as a figure."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_image, require_outputs
from lbacal.selection import find_spectra_files, parse_selection, read_selected
from lbacal.with_model import read_open_terms


def budget(
    spectra: Annotated[list[Path], typer.Argument(help="Spectra files (HDF5, lbacal-spectra-1), or folders of them.")],
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    sky: Annotated[
        str, typer.Option(help="Error of the sky: paper (20 %), models (seven models, 12 %), measured (absolute).")
    ] = "models",
    since: Annotated[str | None, typer.Option(help="First instant of the events to use, ISO 8601, UTC.")] = None,
    until: Annotated[str | None, typer.Option(help="End of the events to use, not included.")] = None,
    year: Annotated[int | None, typer.Option(help="One calendar year, in the place of both.", min=1, max=9998)] = None,
    station: Annotated[list[str] | None, typer.Option(help="Station to use; may be given several times.")] = None,
    left_open: Annotated[
        str | None,
        typer.Option(help="What an investigation of these data leaves open: R.json, or R.json#n where n is adopted."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Terms with their vectors (JSON).")] = None,
    plot: Annotated[Path | None, typer.Option(help="Terms stacked against frequency (PNG, PDF or SVG).")] = None,
) -> None:
    """Print how far C may be off, term by term as in Table 1 of the paper; every term is a refit of these spectra.

    Example: lbacal budget spectra.h5 --instrument lofar-superterp --sky measured --plot budget.png
    """
    from lbacal.pages.budget import draw_budget, tabulate
    from lbacal_core.calibration.chain_form import compare_forms
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.uncertainty.refit import compute_budget, measure_electronics

    selection = parse_selection(since, until, year, station)
    files = find_spectra_files(spectra)
    inputs = {"--instrument": instrument, "--sky-power": sky_power}
    require_outputs({"--report": report, "--plot": plot}, {**inputs, **{f"SPECTRA {file}": file for file in files}})
    require_image(plot)
    measured = read_selected(files, selection, time.time())
    simulation = Simulation.load(instrument, sky_power)
    simulation = simulation.with_form(compare_forms(measured, simulation).name)
    shared, of_antennas = compute_budget(measured, simulation, sky), measure_electronics(measured, simulation)
    terms = [*shared.terms, *([] if of_antennas is None else [of_antennas])]
    if left_open is not None:
        members = sorted(set(zip(measured.station.tolist(), measured.antenna.tolist(), strict=True)))
        terms += [one.for_mean_of(members, terms[0].vectors) for one in read_open_terms(left_open, "--left-open")]
    for line in tabulate(shared.frequency_mhz, terms):
        print(line)
    print(f"budget {shared.digest}")
    if report is not None:
        report.write_text(json.dumps({shared.digest: shared.as_dict()}, indent=1, allow_nan=False) + "\n")
    if plot is not None:
        draw_budget(shared, terms).savefig(plot, dpi=150)
