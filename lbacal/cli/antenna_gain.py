"""`lbacal antenna-gain`: an instrument file with G_ant of an antenna model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside


def antenna_gain(
    instrument: Annotated[Path, typer.Option(help="Instrument file (JSON); it need not have antenna_gain.")],
    antenna: Annotated[str, typer.Option(help="File of Jones terms in V per V/m (.npz or text).")],
    source: Annotated[str, typer.Option(help="Who computed or measured the table, and how: kept with the numbers.")],
    output: Annotated[Path, typer.Option(help="Instrument file to write (JSON).")],
    absolute: Annotated[
        bool, typer.Option(help="The table is V per V/m at the load; without it G_ant is right up to a factor.")
    ] = False,
    shape_error: Annotated[float | None, typer.Option(help="Standard deviation of ln G_ant over frequency.")] = None,
    scale_error: Annotated[float | None, typer.Option(help="Standard deviation of its common factor.")] = None,
) -> None:
    """Take G_ant of an instrument from an antenna model, with its provenance and error.

    Example: lbacal antenna-gain --instrument I.json --antenna lba.npz --source "NEC, our model" --output I2.json
    """
    from lbacal_core.antenna.names import take_antenna_gain
    from lbacal_core.errors import BadInputError
    from lbacal_core.foreign import read_json
    from lbacal_core.instrument.instrument import parse_instrument

    require_outputs({"--output": output}, {"--instrument": instrument, "--antenna": antenna})
    content = read_json(instrument)
    if not isinstance(content, dict):
        raise BadInputError(str(instrument), "a JSON object", type(content).__name__)
    made = take_antenna_gain(
        content,
        str(instrument),
        antenna,
        source,
        is_absolute=absolute,
        shape_error=shape_error,
        scale_error=scale_error,
    )
    checked = parse_instrument(made, str(instrument))
    with written_beside(output) as beside:
        beside.write_text(json.dumps(made, allow_nan=False) + "\n")
    best = checked.frequency_mhz[checked.antenna_gain.argmax()]
    print(
        f"G_ant at most {checked.antenna_gain.max():.4g} at {best:g} MHz; {checked.antenna_gain_note}; wrote {output}"
    )
