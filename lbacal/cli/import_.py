"""`lbacal import`: data in other formats to background spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lbacal.cli.outputs import require_outputs
from lbacal.files import written_beside

DEFAULT_INTERVAL_S = 900.0


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
    from lbacal_core.errors import BadInputError
    from lbacal_core.instrument.instrument import load_instrument
    from lbacal_core.readers.open import choose_channels, open_source
    from lbacal_core.readers.source import average as average_source
    from lbacal_core.spectra.spectra import write_spectra

    require_outputs({"--output": output}, {"SOURCE": source, "--instrument": instrument})
    for option, value in (("--average", average), ("--channel-mhz", channel_mhz)):
        if value is not None and not 0 < value < float("inf"):
            raise BadInputError(option, "a number > 0", f"{value}")
    if instrument is not None and channel_mhz is not None:
        raise BadInputError("lbacal import", "--instrument or --channel-mhz", "both")
    if events and average is not None:
        raise BadInputError("lbacal import", "--average or --events", "both")
    interval = None if events else average or DEFAULT_INTERVAL_S
    opened = open_source(source, station)
    for note in opened.notes:
        print(note)
    chain = load_instrument(instrument) if instrument else None
    result = average_source(opened, interval, choose_channels(opened, chain, band, channel_mhz))
    spectra = result.spectra
    with written_beside(output) as beside:
        write_spectra(spectra, beside)
    if result.channels_left_out.size:
        low, high = result.channels_left_out[[0, -1]]
        print(f"{result.channels_left_out.size} channels between {low:g} and {high:g} MHz are flagged, left out")
    if result.spectra_left_out:
        print(f"{result.spectra_left_out} spectra lack one of the other channels, left out")
    for flag, count in result.flags.items():
        print(f"{count} spectra are flagged {flag!r}: the file keeps them, fits leave them out")
    number, channels = len(set(spectra.event_id.tolist())), spectra.frequency_mhz
    of_what = "events" if interval is None else f"intervals of {interval:g} s"
    print(
        f"wrote {output}: {len(spectra)} spectra, {number} {of_what} from {result.integrations} "
        f"integrations, {channels.size} channels from {channels[0]:g} to {channels[-1]:g} MHz"
    )
