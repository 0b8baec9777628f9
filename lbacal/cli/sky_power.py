"""`lbacal sky-power`: P_sky(LST, nu) of an instrument, written to a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import InstrumentName, require_outputs
from lbacal.files import written_beside
from lbacal_core.errors import BadInputError
from lbacal_core.foreign import read_json
from lbacal_core.instrument.instrument import find_instrument, load_instrument, parse_instrument


def sky_power(
    instrument: InstrumentName,
    output: Annotated[Path, typer.Option(help="Sky power file to write (JSON).")],
    sky: Annotated[str | None, typer.Option(help="Sky model: a name, or a file; else the instrument's.")] = None,
    antenna: Annotated[
        str | None, typer.Option(help="Antenna model: a name, or a file; else the instrument's.")
    ] = None,
    scale: Annotated[float, typer.Option(help="Factor on the brightness of the sky model.")] = 1.0,
    spectral_index: Annotated[float, typer.Option(help="Added to the index b of T ~ nu^-b, about 60 MHz.")] = 0.0,
    isotropic: Annotated[float, typer.Option(help="Isotropic brightness to add, in units of the extragalactic.")] = 0.0,
    source: Annotated[
        list[str] | None, typer.Option(help="Point source to add: cas-a, cyg-a, tau-a, vir-a; may be repeated.")
    ] = None,
    year: Annotated[float, typer.Option(help="Year of the sources (Cas A fades).")] = 2015.0,
) -> None:
    """Compute the directional sky power of both dipoles against local sidereal time and frequency.

    Example: lbacal sky-power --instrument lofar-superterp --output P.json
    """
    from lbacal_core.sky.antenna_of import antenna_of
    from lbacal_core.sky.model import find_sources
    from lbacal_core.sky.names import default_sky, load_sky
    from lbacal_core.sky.power import compute_sky_power
    from lbacal_core.sky.sources import add_sources
    from lbacal_core.sky.table import write_sky_power

    require_outputs({"--output": output}, {"--instrument": instrument, "--sky": sky, "--antenna": antenna})
    chain = load_instrument(instrument)
    model = load_sky(sky or chain.sky or default_sky(chain.frequency_mhz)).changed(scale, spectral_index, isotropic)
    pattern = antenna or antenna_of(chain)
    result = compute_sky_power(chain, model, pattern)
    result = add_sources(result, chain, find_sources(source or []), year, pattern)
    with written_beside(output) as beside:
        write_sky_power(result, beside)
    for dipole, values in result.power.items():
        variation = values.sum(axis=1)
        arm = chain.dipole_azimuth_deg[dipole]
        print(
            f"{dipole} (arm at {arm:g} deg): maximum at LST {result.lst_hours[variation.argmax()]:.2f} h, "
            f"{variation.max() / variation.min():.3f} times the minimum"
        )
    print(f"{result.origin}; wrote {output}")


# `lbacal antenna-gain`: an instrument file with G_ant of an antenna model.


def antenna_gain(
    instrument: Annotated[str, typer.Option(help="Name or file (JSON) of one; it need not have antenna_gain.")],
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

    require_outputs({"--output": output}, {"--instrument": instrument, "--antenna": antenna})
    content = read_json(find_instrument(instrument))
    if not isinstance(content, dict):
        raise BadInputError(instrument, "a JSON object", type(content).__name__)
    made = take_antenna_gain(
        content, instrument, antenna, source, is_absolute=absolute, shape_error=shape_error, scale_error=scale_error
    )
    checked = parse_instrument(made, instrument)
    with written_beside(output) as beside:
        beside.write_text(json.dumps(made, allow_nan=False) + "\n")
    best = checked.frequency_mhz[checked.antenna_gain.argmax()]
    most = f"{checked.antenna_gain.max():.4g}{' m^2' if absolute else ''}"
    print(f"G_ant at most {most} at {best:g} MHz; {checked.antenna_gain_note}; wrote {output}")
