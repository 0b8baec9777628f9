"""`lbacal sky-power`: P_sky(LST, nu) of an instrument, written to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def sky_power(
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    output: Annotated[Path, typer.Option(help="Sky power file to write (JSON).")],
    sky: Annotated[str | None, typer.Option(help="Sky model: a name, or a file.")] = None,
    antenna: Annotated[str | None, typer.Option(help="Antenna model: a name, or a file.")] = None,
) -> None:
    """Compute the directional sky power of both dipoles against local sidereal time and frequency.

    Example: lbacal sky-power --instrument lofar-superterp --output P.json
    """
    from lbacal_core.antenna.names import DEFAULT_ANTENNA
    from lbacal_core.instrument import load_instrument
    from lbacal_core.sky.names import DEFAULT_SKY
    from lbacal_core.skypower.model import compute_sky_power
    from lbacal_core.skypower.table import write_sky_power

    chain = load_instrument(instrument)
    result = compute_sky_power(chain, sky or DEFAULT_SKY, antenna or DEFAULT_ANTENNA)
    write_sky_power(result, output)
    for dipole, values in result.power.items():
        variation = values.sum(axis=1)
        arm = chain.dipole_azimuth_deg[dipole]
        print(
            f"{dipole} (arm at {arm:g} deg): maximum at LST {result.lst_hours[variation.argmax()]:.2f} h, "
            f"{variation.max() / variation.min():.3f} times the minimum"
        )
    print(f"{result.origin}; wrote {output}")
