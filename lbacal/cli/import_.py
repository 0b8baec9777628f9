"""`lbacal import`: data in other formats to background spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside


def import_(
    source: Annotated[Path, typer.Argument(help="File or folder: .uvh5, .uvfits, SST of LOFAR, NenuFAR, .csv, .npz.")],
    output: Annotated[Path, typer.Option(help="Spectra file to write (HDF5).")],
    average: Annotated[float | None, typer.Option(help="Seconds that one spectrum averages (900).")] = None,
    events: Annotated[
        bool, typer.Option("--events", help="Every integration is an event of its own: one spectrum each.")
    ] = False,
    instrument: Annotated[
        str | None, typer.Option(help="Instrument (name or JSON file) whose channels to average to.")
    ] = None,
    channel_mhz: Annotated[float | None, typer.Option(help="Width of the channels to average to, MHz.")] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="Lowest and highest channel, MHz.", metavar="LO HI")
    ] = None,
    station: Annotated[str | None, typer.Option(help="Name of the station where the data have none.")] = None,
) -> None:
    """Average autocorrelations or station statistics to background spectra, whatever the length of the data.

    Example: lbacal import zen.autos.uvh5 --output S.h5 --average 60 --channel-mhz 1 --band 50 200

    Flagged samples count nowhere; quality flags of integrations stay with their spectra. Memory holds the averages and
    a minute of data.
    """
    from lbacal.averaging import Named, average_data
    from lbacal_core.instrument.instrument import load_instrument
    from lbacal_core.spectra.spectra import write_spectra

    require_outputs({"--output": output}, {"SOURCE": source, "--instrument": instrument})
    named = Named("--average", "--events", "--instrument", "--channel-mhz")
    chain = load_instrument(instrument) if instrument else None
    spectra, said = average_data(source, average, chain, channel_mhz, band, station, is_event_each=events, named=named)
    with written_beside(output) as beside:
        write_spectra(spectra, beside)
    print("\n".join([*said[:-1], f"wrote {output}: {said[-1]}"]))
