"""`lbacal lst-curve`: a measured LST curve against simulated sky power."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside


def lst_curve(
    curve: Annotated[Path, typer.Argument(help="LST curve (CSV: lst_h, x_db, y_db, error_db).")],
    report: Annotated[Path, typer.Option(help="Report to write (JSON).")],
    sky_power: Annotated[
        Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
    ] = None,
    instrument: Annotated[str, typer.Option(help="Instrument: a name or a JSON file.")] = "lofar-superterp",
    band: Annotated[tuple[float, float], typer.Option(help="First and last channel of the band, MHz.")] = (30.0, 80.0),
    plot: Annotated[Path | None, typer.Option(help="Figure to write (PNG, PDF or SVG, by its ending).")] = None,
) -> None:
    """Compare band power against sidereal time, measured and simulated.

    Nothing is fitted but, for each dipole, an offset and the share of electronic noise in the power (0 to 1).

    Example: lbacal lst-curve measured.csv --report lst.json --plot lst.png
    """
    from lbacal_core.errors import BadInputError
    from lbacal_core.instrument.instrument import load_instrument
    from lbacal_core.lstcurve.curve import (
        AS_RECORDED,
        band_weights,
        compare_lst_curve,
        read_lst_curve,
        simulate_band_power,
    )
    from lbacal_core.skypower.table import read_sky_power

    require_outputs(
        {"--report": report, "--plot": plot}, {"CURVE": curve, "--instrument": instrument, "--sky-power": sky_power}
    )
    if plot is not None and plot.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise BadInputError(f"--plot {plot}", "a file ending in .png, .pdf or .svg", plot.suffix or "no ending")
    measured = read_lst_curve(curve)
    chain = load_instrument(instrument)
    if sky_power is None:
        from lbacal_core.skypower.model import compute_sky_power

        sky = compute_sky_power(chain)
    else:
        sky = read_sky_power(sky_power)
    sky.require_made_for(chain)
    result = compare_lst_curve(measured, sky, chain, band)
    with written_beside(report) as beside:
        beside.write_text(json.dumps(result.as_dict(), indent=1, allow_nan=False) + "\n")
    if plot is not None:
        from lbacal.pages.report import FULL_DAY, draw_lst_comparison

        weights = band_weights(chain, AS_RECORDED, band)
        simulated = {dipole: simulate_band_power(sky, dipole, FULL_DAY, weights) for dipole in ("X", "Y")}
        with written_beside(plot) as beside:
            draw_lst_comparison(result, simulated).savefig(beside, dpi=150)
    for has_noise in (False, True):
        for dipole in ("X", "Y"):
            one = result.of(dipole, has_noise=has_noise)
            words = f"sky and noise (share {one.noise_share:.3f})" if has_noise else "sky alone"
            print(f"{dipole}, {words}: chi2 per point {one.chi2 / one.points:.2f}, rms {one.rms_db:.3f} dB")
    print(f"wrote {report}" + (f" and {plot}" if plot else ""))
