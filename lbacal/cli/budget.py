"""`lbacal budget`: how far C may be off and why, as a table and as a figure."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from lbacal.cli.fit_inputs import find_spectra_files, parse_selection, read_selected
from lbacal.cli.outputs import require_image, require_outputs
from lbacal.cli.with_model import read_open_terms
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.grids import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER_TOTAL = 0.13
"""Table 1 of Mulrey et al. 2019, below 77 MHz."""
SHOWN = 6
"""Frequencies of the table, from the lowest channel to the highest."""


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


def tabulate(frequency_mhz: Floats, terms: list[BudgetTerm]) -> list[str]:
    """The standard deviation of C by each term and by all together, per cent, X / Y at a few frequencies."""
    at = np.unique(np.linspace(0, frequency_mhz.size - 1, SHOWN).round().astype(int))
    width = max(len(term.name) for term in terms)
    lines = [" ".join([f"{'sigma(C), %, X / Y':{width}}", *(f"{frequency_mhz[k]:7g} MHz" for k in at)])]
    rows = [(term.name, {p: term.variance(p) for p in term.vectors}) for term in terms]
    total = {p: np.sum([variance[p] for _, variance in rows], axis=0) for p in rows[0][1]}
    for name, variance in [*rows, ("total", total)]:
        cells = ["/".join(f"{100 * np.sqrt(v[k]):.1f}" for v in variance.values()) for k in at]
        lines.append(" ".join([f"{name:{width}}", *(f"{cell:>11}" for cell in cells)]))
    lines.append(describe_best(frequency_mhz, terms))
    if any(term.is_of_gain for term in terms):
        lines.append("C/|H| has no error of the antenna gain.")
    return lines


def describe_best(frequency_mhz: Floats, terms: list[BudgetTerm]) -> str:
    """Where C is known best, beside the paper's total, and the term that keeps it from being known better."""
    variance = np.array([[term.variance(p) for p in term.vectors] for term in terms])
    at = int(np.argmin(variance.sum(axis=(0, 1))))
    here = variance[:, :, at]
    largest = int(np.argmax(here.sum(axis=1)))
    total, rest = ("/".join(f"{100 * np.sqrt(v):.1f}" for v in here.sum(axis=0) - w) for w in (0.0, here[largest]))
    return (
        f"C is known best at {frequency_mhz[at]:g} MHz, to {total} % (the paper: {PAPER_TOTAL:.0%}); the largest term "
        f"there is {terms[largest].name}, without which {rest} % would be left."
    )


def draw_budget(shared: Budget, terms: list[BudgetTerm]) -> Figure:
    """Variances stacked against frequency, on the scale of the standard deviation of what lies below."""
    from matplotlib.figure import Figure

    polarisations = list(terms[0].vectors)
    figure = Figure(figsize=(5.2 * len(polarisations), 5.0), layout="constrained")
    panels: Any = np.atleast_1d(figure.subplots(1, len(polarisations), sharey=True))
    for axes, polarisation in zip(panels, polarisations, strict=True):
        below = np.zeros(shared.frequency_mhz.size)
        for k, term in enumerate(terms):
            above = below + term.variance(polarisation)
            axes.fill_between(
                shared.frequency_mhz, 100 * np.sqrt(below), 100 * np.sqrt(above), color=f"C{k % 10}",
                alpha=0.75 if k < 10 else 0.4, lw=0,
                label=term.name,
            )  # fmt: skip
            below = above
        axes.plot(shared.frequency_mhz, 100 * np.sqrt(below), color="black", lw=1.4, label="total")
        axes.set(xlabel="frequency (MHz)", title=f"polarisation {polarisation}", ylim=(0, None))
        axes.set_xlim(shared.frequency_mhz[0], shared.frequency_mhz[-1])
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("systematic error of C (%), terms added in quadrature")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, ncols=3, loc="outside lower center")
    return figure
