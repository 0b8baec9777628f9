"""`lbacal check-table` and `lbacal export`: files of calibration curves (docs/formats/galcal.md)."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.client import Antenna, Dipole, Station
from lbacal.cli.outputs import Json, require_outputs, show
from lbacal.files import written_beside
from lbacal.tables import mean_curve
from lbacal_core.curves.galcal import find_problems, name_path
from lbacal_core.errors import BadInputError, LbacalError, offer_name
from lbacal_core.instrument.instrument import load_instrument

File = Annotated[Path, typer.Argument(help="Calibration file: .ecsv, .fits, .h5 or .json.")]


ExportFormat = StrEnum("ExportFormat", ["ecsv", "fits", "hdf5", "csv", "json", "nuradio", "uvcal", "lofar2"])
"""What `export` writes."""
OF_OTHER_PROGRAMS = {".txt": "nuradio", ".calfits": "uvcal", ".calh5": "uvcal"}


def check_table(
    files: Annotated[list[Path], typer.Argument(help="Calibration files: .ecsv, .fits, .h5 or .json.")],
    as_json: Json = False,
) -> None:
    """Check that calibration files follow galcal-1 and agree with themselves.

    Example: lbacal check-table C.ecsv effective.fits

    Exit 0 if all files agree, 1 if one does not, 2 if one cannot be read.
    """
    from lbacal.calibration_files import read_calibrations

    found: list[dict[str, Any]] = []
    unread: list[LbacalError] = []
    for path in files:
        try:
            content = read_calibrations(path)
        except LbacalError as error:
            unread.append(error)
            continue
        problems = find_problems(content)
        told = f"{len(problems)} problems" if problems else _describe(content)
        found.append({"file": str(path), "summary": told, "problems": problems})
    show(found, lambda _: print("\n".join(map(_list_problems, found))), as_json=as_json)
    for other in unread[1:]:
        print(f"lbacal: {other}", file=sys.stderr)
    if unread:
        raise unread[0]
    if any(one["problems"] for one in found):
        raise typer.Exit(1)


def _list_problems(one: dict[str, Any]) -> str:
    return "\n  ".join([f"{one['file']}: {one['summary']}", *one["problems"]])


def export(
    source: File,
    output: Annotated[Path, typer.Option(help="File to write; its ending says in which format.")],
    kind: Annotated[
        ExportFormat | None, typer.Option("--format", help="Format, where the ending does not say it (lofar2).")
    ] = None,
    station: Station = None,
    antenna: Antenna = None,
    dipole: Dipole = None,
    mean: Annotated[bool, typer.Option("--mean", help="nuradio: one curve, that of the mean recorded power.")] = False,
    instrument: Annotated[str | None, typer.Option(help="uvcal: where the antennas stand, and their arms.")] = None,
    at: Annotated[str | None, typer.Option(help="When the data are taken, for a file that does not say it.")] = None,
) -> None:
    """Write calibration curves of a file in another format.

    Example: lbacal export C.ecsv --output C.calfits --instrument lofar-superterp --at 2014-05-01

    ecsv, fits, hdf5 and json keep everything; csv has the rows; nuradio (.txt), uvcal (.calfits, .calh5) and lofar2
    (with --format) have C for those programs.
    """
    from lbacal.calibration_files import FORMATS, read_calibrations, write_calibrations
    from lbacal.exports import write_station_table, write_uvcal

    by_suffix = FORMATS | OF_OTHER_PROGRAMS
    chosen = kind or by_suffix.get(output.suffix.lower())
    if chosen is None:
        raise BadInputError("--output", f"--format, or a name that ends in {', '.join(by_suffix)}", output.name)
    chosen = ExportFormat(chosen)
    if mean and chosen is not ExportFormat.nuradio:
        raise BadInputError("--mean", "the format nuradio", chosen.value)
    require_outputs({"--output": output}, {"SOURCE": source, "--instrument": instrument})
    content = read_calibrations(source)
    content["at"] = content["at"] or at
    held = [name_path(curve) for curve in content["curves"]]
    content["curves"] = [
        curve
        for curve in content["curves"]
        if station in (None, curve["station"]) and antenna in (None, curve["antenna"])
        and dipole in (None, curve["dipole"])
    ]  # fmt: skip
    if not content["curves"]:
        wanted = offer_name(name_path({"station": station, "antenna": antenna, "dipole": dipole}), held)
        raise BadInputError(str(source), "a curve of that station, antenna and dipole", f"none of {wanted}")
    with written_beside(output) as beside:
        if chosen is ExportFormat.uvcal:
            if instrument is None:
                raise BadInputError("--instrument", "the instrument, for its place and its arms", "none")
            write_uvcal(content, load_instrument(instrument), beside)
        elif chosen is ExportFormat.lofar2:
            write_station_table(content, beside)
        else:
            write_calibrations(mean_curve(content) if mean else content, beside, chosen.value)
    print(f"wrote {output}: {len(content['curves'])} curves as {chosen.value}")


def _describe(content: dict[str, Any]) -> str:
    """One line about a file that follows its format."""
    curves = content["curves"]
    low, high = (pick(pick(curve["frequency_mhz"]) for curve in curves) for pick in (min, max))
    covered = sum(bool(curve.get("covariance")) for curve in curves)
    parts = [
        f"{len(curves)} curves, {low:g} to {high:g} MHz",
        f"covariance of {covered}",
        f"{len(content['budgets'])} budgets",
        *([f"in effect at {content['at']}"] if content["at"] else []),
        *([f"as of {content['as_of']}"] if content["as_of"] else []),
    ]
    return f"follows galcal-1: {', '.join(parts)}"
