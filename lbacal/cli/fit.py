"""`lbacal fit`: calibration curves from a spectra file, without a database."""

from __future__ import annotations

import time
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside
from lbacal_core.curves import CalibrationCurve
from lbacal_core.reference_chain import ReferenceChain


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
    spectra: Annotated[Path, typer.Argument(help="Spectra file (HDF5, lbacal-spectra-1).")],
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    output: Annotated[Path, typer.Option(help="Calibration table to write (ECSV).")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON), whatever the outcome.")],
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    scope: Annotated[Scope, typer.Option(help="What one curve belongs to.")] = Scope.antenna,
) -> None:
    """Fit the signal chain to background spectra and write C(nu) with its errors.

    Example: lbacal fit spectra.h5 --instrument lofar-superterp --scope station --output C.ecsv --report fit.json

    Exit 0 if any curve converged, else 1; the report is written either way.
    """
    from lbacal_core.anomalies import Anomalies
    from lbacal_core.curves import CONVERGED, MISFIT, write_calibration_table, write_fit_report
    from lbacal_core.instrument import load_instrument
    from lbacal_core.pipeline import calibrate
    from lbacal_core.skypower.table import read_sky_power
    from lbacal_core.spectra import read_spectra

    require_outputs(
        {"--output": output, "--report": report},
        {"SPECTRA": spectra, "--instrument": instrument, "--sky-power": sky_power},
    )
    chain = load_instrument(instrument)
    measured = read_spectra(spectra, now_unix=time.time())
    sky = None if sky_power is None else read_sky_power(sky_power)
    result = calibrate(measured, chain, sky, scope.value)
    with written_beside(report) as beside:
        write_fit_report(result, beside)
    with written_beside(output) as beside:
        write_calibration_table(result, beside)
    converged = [curve for curve in result.curves if curve.status == CONVERGED]
    print(f"{len(converged)} of {len(result.curves)} curves converged; wrote {output} and {report}")
    for name, note in result.provenance.notes.items():
        print(f"{name}: {note}")
    found = Anomalies.of(result.anomalies)
    if found.worst:
        print(
            f"anomalous power: {found.left_out} of {len(measured)} spectra left out, {found.fitted} fitted; "
            f"worst: {found.name_worst(3)}"
        )
    misfits = [curve for curve in result.curves if curve.status == MISFIT]
    if misfits:
        print(describe_misfits(misfits, f"lbacal investigate {spectra} --instrument {instrument}", sky_power))
    for curve in result.curves:
        if curve.status not in (CONVERGED, MISFIT):
            print(f"{curve.name}: {curve.status} ({curve.events} events, LST coverage {curve.lst_coverage:.2f})")
    for curve, reference in zip(result.curves, result.chains, strict=True):
        if reference is not None and curve.antenna is None:
            print(f"{curve.name}: {describe_chain(reference)}")
    if not converged:
        raise typer.Exit(1)
