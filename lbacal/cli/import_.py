"""`lbacal import`: data in other formats to background spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import progress, require_outputs


def import_(
    source: Annotated[
        Path,
        typer.Argument(help="File or folder: .uvh5, .uvfits, .ms, SST of LOFAR, NenuFAR, SKA-Low's .hdf5, .csv, .npz."),
    ],
    output: Annotated[Path, typer.Option(help="Spectra file to write (HDF5).")],
    average: Annotated[
        float | None, typer.Option(help="Seconds that one spectrum averages (900 of what has no event_id).")
    ] = None,
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

    Flagged samples count nowhere; quality flags of integrations stay with their spectra.
    """
    from lbacal.analysis.data import import_data

    require_outputs({"--output": output}, {"SOURCE": source, "--instrument": instrument})
    with progress() as tell:
        spectra = import_data(source, average, instrument, channel_mhz, band, station, events=events, tell=tell)
    spectra.save(output, ".h5")
    print("\n".join([*spectra.notes[:-1], f"wrote {output}: {spectra.notes[-1]}"]))
