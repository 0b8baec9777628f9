"""`lbacal sky-power`: P_sky(LST, nu) of an instrument, written to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside


def sky_power(
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
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
    from lbacal_core.instrument.instrument import load_instrument
    from lbacal_core.sky.names import default_sky, load_sky
    from lbacal_core.sky.sources import find_sources
    from lbacal_core.skypower.antenna_of import antenna_of
    from lbacal_core.skypower.model import compute_sky_power
    from lbacal_core.skypower.sources import add_sources
    from lbacal_core.skypower.table import write_sky_power

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
