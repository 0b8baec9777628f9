"""`lbacal fit`: calibration curves from spectra files, without a database."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from lbacal.cli.fit_inputs import find_spectra_files, parse_selection, read_selected
from lbacal.cli.outputs import progress, require_image, require_outputs
from lbacal.cli.with_model import HELP, read_model, read_open_terms, report_path
from lbacal.files import written_beside
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.reference_chain import ReferenceChain

if TYPE_CHECKING:
    from lbacal_core.curves.curves import FitReport
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.spectra.spectra import Spectra

STEPS_OF_FIT = 2
"""What the progress bar counts beside the files: the fit, and the error of one event."""


class Scope(StrEnum):
    """What one curve belongs to."""

    array = "array"
    station = "station"
    antenna = "antenna"


def describe_chain(chain: ReferenceChain) -> str:
    """What a curve of many paths belongs to, and how far single paths depart from it, in one sentence."""
    if chain.spreads is None:
        known = "too few paths could be fitted by themselves to know how far they depart from it"
    else:
        departures = [
            f"{100 * np.median(one.offset):+.1f} % with a spread of {100 * np.median(one.spread):.1f} % (cable {cable})"
            for cable, one in (chain.spreads.by_cable or {"any": chain.spreads.all_paths}).items()
        ]
        known = f"power gain of single paths against it: {', '.join(departures)}"
    return f"reference chain of {len(chain.members)} paths, nobody's cable; {known}"


def describe_misfits(misfits: Sequence[CalibrationCurve], command: str, sky_power: Path | None) -> str:
    """Which curves noise and the freedom of the sky cannot explain, and the command to run next."""
    alone, profiled = (
        [float(getattr(curve, name) or 0.0) for curve in misfits] for name in ("chi2_per_dof", "chi2_per_dof_profiled")
    )
    names = misfits[0].name if len(misfits) == 1 else f"{len(misfits)} curves, {misfits[0].name} to {misfits[-1].name}"
    free, given = "sky and pattern free within what is known of them", ""
    if sky_power is not None:
        free, given = "the sky power taken at its word", f" --sky-power {sky_power}"
    return (
        f"misfit: {names}: chi2/dof {np.median(alone):.1f} with noise alone, {np.median(profiled):.1f} with {free} "
        "(1 expected): units, clock, place, letters or antenna may be wrong; "
        f"next: {command}{given} --report R.json --html R.html"
    )


def fit(
    spectra: Annotated[list[Path], typer.Argument(help="Spectra files (HDF5, lbacal-spectra-1), or folders of them.")],
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    output: Annotated[Path, typer.Option(help="Calibration table: .ecsv, .fits, .h5, .json, or .csv (rows).")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON), whatever the outcome.")],
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    scope: Annotated[Scope, typer.Option(help="What one curve belongs to.")] = Scope.antenna,
    since: Annotated[str | None, typer.Option(help="First instant of the events to use, ISO 8601, UTC.")] = None,
    until: Annotated[str | None, typer.Option(help="End of the events to use, not included.")] = None,
    year: Annotated[int | None, typer.Option(help="One calendar year, in the place of both.", min=1, max=9998)] = None,
    station: Annotated[list[str] | None, typer.Option(help="Station to use; may be given several times.")] = None,
    with_: Annotated[str | None, typer.Option("--with", metavar="R.json[#n]", help=HELP)] = None,
    html: Annotated[Path | None, typer.Option(help="Page to write: table, figure, budget (one HTML file).")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Figure to write: C with its errors, residuals, noise, chi2 (PNG, PDF or SVG).")
    ] = None,
) -> None:
    """Fit the signal chain to background spectra and write C(nu) with its errors.

    Example: lbacal fit 2014/ --instrument lofar-superterp --scope station --year 2014 --output C.ecsv --report fit.json
    --html fit.html

    Exit 0 if any curve converged, else 1; the report is written either way.
    """
    from lbacal.calibration_files import require_format
    from lbacal.pages.fit_summary import align, describe_error, explain_chi2, tabulate_curves
    from lbacal_core.audit.audit import audit_quickly
    from lbacal_core.curves.curves import CONVERGED, write_fit_report
    from lbacal_core.pipeline import calibrate
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.uncertainty.left_open import widen_by_open_terms
    from lbacal_core.uncertainty.one_event import measure_error

    selection = parse_selection(since, until, year, station)
    files = find_spectra_files(spectra)
    known = {"--instrument": instrument, "--sky-power": sky_power, "--with": with_ and report_path(with_)}
    require_outputs(
        {"--output": output, "--report": report, "--html": html, "--plot": plot},
        {**known, **{f"SPECTRA {file}": file for file in files}},
    )
    kind = require_format("--output", output)
    require_image(plot)
    model, left_open = read_model(with_), read_open_terms(with_)
    model.require_one_c(f"--with {with_}")
    simulation = Simulation.load(instrument, sky_power, model)
    with progress(len(files) + STEPS_OF_FIT + (html is not None or plot is not None)) as tell:
        measured = read_selected(files, selection, time.time(), tell)
        audited = audit_quickly(measured, simulation.instrument)
        audited.require_power(measured.origin)
        tell(f"fit {len(measured)} spectra")
        result = audited.mark(widen_by_open_terms(calibrate(measured, simulation, scope.value), left_open))
        tell("error of one event")
        error = measure_error(result, measured, simulation)
        with written_beside(report) as beside:
            write_fit_report(result, beside)
        _write_table(result, simulation, output, kind)
        numbers = [] if error is None else [describe_error(error)]
        if html is not None or plot is not None:
            tell("draw")
            _draw(result, measured, simulation, html, plot, numbers)
    converged = [curve for curve in result.curves if curve.status == CONVERGED]
    written = " and ".join(str(path) for path in (output, report, html, plot) if path is not None)
    explained = [explain_chi2(result.curves)] if any(curve.c is not None for curve in result.curves) else []
    rerun = " ".join(str(path) for path in spectra)
    command = f"lbacal investigate {rerun}{selection.options} --instrument {instrument}"
    rest = describe_rest(result, len(measured), command, sky_power)
    first = f"{len(converged)} of {len(result.curves)} curves converged; wrote {written}"
    print("\n".join([first, *align(tabulate_curves(result.curves)), *numbers, *explained, *rest]))
    if not converged:
        raise typer.Exit(1)


def describe_rest(report: FitReport, spectra: int, command: str, sky_power: Path | None) -> Iterator[str]:
    """What else there is to know: inputs, anomalous power, misfits, curves without values, and reference chains."""
    from lbacal_core.calibration.paths import LEAST_COVERAGE
    from lbacal_core.curves.curves import CONVERGED, MISFIT, Anomalies

    for name, note in report.provenance.notes.items():
        yield f"{name}: {note}"
    found = Anomalies.of(report.anomalies)
    if found.worst:
        yield (
            f"anomalous power: {found.left_out} of {spectra} spectra left out, {found.fitted} fitted; "
            f"worst: {found.name_worst(3)}"
        )
    misfits = [curve for curve in report.curves if curve.status == MISFIT]
    if misfits:
        yield describe_misfits(misfits, command, sky_power)
    for curve in report.curves:
        if curve.status not in (CONVERGED, MISFIT):
            needed = f", {LEAST_COVERAGE:.2f} needed" if curve.lst_coverage < LEAST_COVERAGE else ""
            yield f"{curve.name}: {curve.status} ({curve.events} events, LST coverage {curve.lst_coverage:.2f}{needed})"
    reasons = [curve.merged.reason for curve in report.curves if curve.merged is not None]
    for reason in dict.fromkeys(reasons):
        yield f"{reasons.count(reason)} of {len(report.curves)} curves: {reason}"
    levels = [curve.sky_over_model for curve in report.curves if curve.sky_over_model is not None]
    if levels:
        yield f"median of {len(levels)} curves: {sorted(levels, key=lambda one: one.mean)[len(levels) // 2]}"
    for curve, reference in zip(report.curves, report.chains, strict=True):
        if reference is not None and curve.antenna is None:
            yield f"{curve.name}: {describe_chain(reference)}"


def _write_table(result: FitReport, simulation: Simulation, output: Path, kind: str) -> None:
    from lbacal.calibration_files import complete_curves, write_calibrations
    from lbacal_core.curves.galcal import describe_made_with

    made_for = simulation.sky_power.made_for
    made_with = describe_made_with(simulation.instrument, None if made_for is None else made_for.as_dict())
    content = complete_curves(result.as_dict() | made_with, output)
    with written_beside(output) as beside:
        write_calibrations(content, beside, kind)


def _draw(
    result: FitReport,
    measured: Spectra,
    simulation: Simulation,
    html: Path | None,
    plot: Path | None,
    sentences: Sequence[str],
) -> None:
    """Draw the figure once, for both outputs."""
    from lbacal.pages.fit import average_residuals, draw_fit, draw_page

    figure = draw_fit(result, average_residuals(measured, result.curves, simulation), simulation)
    if plot is not None:
        figure.savefig(plot, dpi=150)
    if html is not None:
        with written_beside(html) as beside:
            beside.write_text(draw_page(result, figure, measured.origin, sentences), encoding="utf-8")
