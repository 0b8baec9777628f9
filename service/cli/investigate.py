"""`lbacal investigate`: what the simulation gets wrong in these data."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Annotated

import typer


def investigate(
    spectra: Annotated[Path, typer.Argument(help="Spectra file (HDF5, lbacal-spectra-1).")],
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON).")],
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="The report as a page with its figures (HTML).")] = None,
) -> None:
    """Find what the simulation gets wrong: name the cause, extend the model, measure the gain.

    Example: lbacal investigate spectra.h5 --instrument lofar-superterp --report R.json --html R.html

    Exit 0 for every verdict: consistent, explained, unexplained.
    """
    from lbacal_core.discovery.report import investigate as ask
    from lbacal_core.instrument import load_instrument
    from lbacal_core.skypower.model import compute_sky_power
    from lbacal_core.skypower.table import read_sky_power
    from lbacal_core.spectra import read_spectra
    from service.cli.outputs import require_outputs

    inputs: dict[str, str | Path | None] = {"SPECTRA": spectra, "--instrument": instrument, "--sky-power": sky_power}
    require_outputs({"--report": report, "--html": html}, inputs)
    chain = load_instrument(instrument)
    measured = read_spectra(spectra, now_unix=time.time())
    sky = compute_sky_power(chain) if sky_power is None else read_sky_power(sky_power)
    content, stations = ask(measured, chain, sky, is_own_sky=sky_power is None, progress=_say)
    report.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    if html is not None:
        from service.cli.investigation_page import write_investigation_page

        write_investigation_page(content, stations, html)
    print(f"{content['verdict']}; wrote {report}{f' and {html}' if html else ''}")
    for finding in content["findings"]:
        print(f"  {finding['significance_sigma']:.1f} sigma: {finding['sentence']}")
    if content["unexplained"]:
        print(f"  {content['unexplained']['description']} (p = {content['unexplained']['p_value']:.1e})")


def _say(step: str) -> None:
    print(step, file=sys.stderr)
