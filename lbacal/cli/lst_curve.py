"""`lbacal lst-curve`: a measured LST curve against simulated sky power."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.options import Band, Json, SkyPowerFile
from lbacal.cli.outputs import require_outputs, save_each, show_result


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
