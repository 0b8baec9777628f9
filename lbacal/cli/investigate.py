"""`lbacal investigate`: what the simulation gets wrong in these data."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lbacal.files import written_beside
from lbacal.selection import Selection, find_spectra_files, parse_selection, read_selected
from lbacal.with_model import HELP, read_model, report_path
from lbacal_core.errors import write_chance

if TYPE_CHECKING:
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.spectra.spectra import Spectra


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
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    band: Annotated[tuple[float, float], typer.Option(help="First and last channel of the LST curve's band, MHz.")] = (
        30.0,
        80.0,
    ),
    html: Annotated[Path | None, typer.Option(help="The report as a page with its figures (HTML).")] = None,
    with_: Annotated[str | None, typer.Option("--with", metavar="R.json[#n]", help=HELP)] = None,
    stored: Annotated[bool, typer.Option("--stored", help="Let the service investigate the spectra it keeps.")] = False,
    since: Annotated[str | None, typer.Option(help="First instant of the events to use, ISO 8601, UTC.")] = None,
    until: Annotated[str | None, typer.Option(help="End of the events to use, not included.")] = None,
    year: Annotated[int | None, typer.Option(help="One calendar year, in the place of both.", min=1, max=9998)] = None,
    station: Annotated[
        list[str] | None, typer.Option(help="Station to use; may be given several times, with --stored once.")
    ] = None,
    reason: Annotated[str | None, typer.Option(help="Why the stored spectra are investigated; it is kept.")] = None,
) -> None:
    """Find what the simulation gets wrong: name the cause, extend the model, measure the gain.

    Example: lbacal investigate 2014/ --instrument lofar-superterp --station CS002 --report R.json --html R.html

    Exit 0 for every verdict: consistent, explained, unexplained.

    The service does it with its stored spectra, one report a station and calendar year:
    lbacal investigate --stored --since 2014-01-01 --until 2015-01-01 --reason "new map"
    """
    selection = parse_selection(since, until, year, station)
    if stored:
        from lbacal.cli.stored import Wanted, investigate_stored

        if spectra or lst_curve is not None or with_ is not None:
            raise typer.BadParameter(
                "--stored names spectra and model: no file, no --lst-curve and no --with beside it"
            )
        investigate_stored(Wanted.of(selection, reason), report)
        return
    if report is None:
        raise typer.BadParameter("name the report to write with --report")
    from lbacal.cli.outputs import require_outputs
    from lbacal_core.simulation.simulation import Simulation

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
    require_outputs({"--report": report, "--html": html}, {**inputs, "--instrument": instrument})
    simulation = Simulation.load(instrument or "lofar-superterp", sky_power, read_model(with_))
    if files:
        measured = read_selected(files, selection, time.time(), _say)
        content = _ask_spectra(measured, simulation, html)
    else:
        content = _ask_curve(lst_curve, simulation, band, html)
    with written_beside(report) as beside:
        beside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    print(f"{content['verdict']}; wrote {report}{f' and {html}' if html else ''}")
    _tell(content)


def _tell(content: dict[str, Any]) -> None:
    """Print adopted causes with their sizes, the findings, and what no cause explains."""
    for one in content.get("adopted", []):
        value, sigma, whom = one["size"]["value"], one["size"]["sigma"], f"{one['target']} of {one['station']}"
        print(f"  adopted: {one['cause']} in {whom}, here {value:.3g} ± {sigma:.2g}")
    for finding in content["findings"]:
        print(f"  {finding['significance_sigma']:.1f} sigma: {finding['sentence']}")
        if finding["indistinguishable"]:
            print(f"    these data cannot tell it from {', '.join(finding['indistinguishable'])}")
    if content["unexplained"]:
        print(f"  {content['unexplained']['description']} ({write_chance(content['unexplained']['p_value'])})")
        for finding in content["unexplained"]["similar_to"]:
            print(f"    similar to: {finding['sentence']}")


def _ask_spectra(measured: Spectra, simulation: Simulation, html: Path | None) -> dict[str, Any]:
    from lbacal_core.audit.audit import audit_quickly
    from lbacal_core.discovery.left_open import add_left_open
    from lbacal_core.discovery.report import investigate as ask

    audited = audit_quickly(measured, simulation.instrument)
    audited.require_power(measured.origin)
    print(f"audit: {audited.sentence}")
    content, stations = ask(measured, simulation, progress=_say)
    for name, note in content["provenance"]["notes"].items():
        print(f"{name}: {note}")
    if html is not None:
        from lbacal.pages.investigation import write_investigation_page

        write_investigation_page(content, stations, html)
    content["provenance"]["notes"]["audit"] = audited.sentence
    return add_left_open(content, stations)


def _ask_curve(
    path: Path | None, simulation: Simulation, band: tuple[float, float], html: Path | None
) -> dict[str, Any]:
    from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
    from lbacal_core.lstcurve.curve import measured_curve, read_lst_curve
    from lbacal_core.provenance import Provenance

    curve = read_lst_curve(path or measured_curve())
    found = investigate_curve(curve, simulation, band)
    sky, chain = simulation.sky_power.digest(), simulation.instrument.digest()
    inputs = {"lst_curve": curve.digest(), "sky_power": sky, "instrument": chain}
    settings = {"band_mhz": list(band), "own_sky": simulation.is_own_sky, "policy": found.policy.as_dict()}
    content = describe_curve(found, Provenance(inputs, settings))
    if html is not None:
        from lbacal.pages.curve import write_curve_page

        write_curve_page(content, found, html)
    return content


def _say(step: str) -> None:
    print(step, file=sys.stderr)
