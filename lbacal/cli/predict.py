"""`lbacal predict`: what an antenna should see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.options import Json
from lbacal.cli.outputs import require_outputs, show_result
from lbacal.with_model import HELP, report_path


def predict(
    station: Annotated[str, typer.Option(help="Station.")],
    antenna: Annotated[int, typer.Option(help="Antenna.", min=0)],
    dipole: Annotated[str, typer.Option(help="Letter of the dipole.")],
    at: Annotated[str, typer.Option(help="When, ISO 8601, UTC.")],
    output: Annotated[Path, typer.Option(help="Prediction to write: .h5, .json, .ecsv, .fits, .csv, .html, .png.")],
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
    from lbacal.files import written_beside
    from lbacal_core.errors import BadInputError

    require_outputs({"--output": output}, {"--simulation": simulation, "--with": with_ and report_path(with_)})
    if realisations and output.suffix.lower() not in (".h5", ".hdf5"):
        raise BadInputError("--realisations", "an --output that ends in .h5 or .hdf5", output.suffix or "no ending")
    if with_ and simulation is None:
        raise BadInputError("--with", "--simulation beside it: what is in effect has its causes", "none")
    where: dict[str, Any] = {"station": station, "antenna": antenna, "dipole": dipole}
    found = predict_path(simulation, at=at, **where, temperature=temperature, with_=with_)
    if realisations:
        with written_beside(output) as beside:
            write_prediction(found.content, beside, found.draw_events(realisations, seed))
    else:
        found.save(output)
    show_result(found, [found.title, *found.lines, f"wrote {output}"], as_json=as_json)
