"""Data in other formats as background spectra, for `lbacal import` and `lbacal.import_data`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import Averaged
from lbacal_core.readers.source import average as average_source
from lbacal_core.spectra.spectra import Spectra

DEFAULT_INTERVAL_S = 900.0
"""What one spectrum averages unless something else is asked for."""


class Named(NamedTuple):
    """What a user calls the arguments: those of Python, unless a command says its options."""

    average: str = "average"
    events: str = "events"
    instrument: str = "instrument"
    channel: str = "channel"


def average_data(
    source: Path,
    average_s: float | None = None,
    instrument: Instrument | None = None,
    channel_mhz: float | None = None,
    band_mhz: tuple[float, float] | None = None,
    station: str | None = None,
    *,
    is_event_each: bool = False,
    named: Named = Named(),  # noqa: B008 - a value that nothing changes
) -> tuple[Spectra, list[str]]:
    """Average a source to the channels of an instrument, to those of one width, or to its own.

    Parameters
    ----------
    is_event_each
        Whether every integration is an event of its own, and nothing is averaged in time.

    Returns
    -------
    The spectra, and what was left out and what remains, a sentence each.
    """
    for name, value in ((named.average, average_s), (named.channel, channel_mhz)):
        if value is not None and not 0 < value < np.inf:
            raise BadInputError(name, "a number > 0", f"{value}")
    if instrument is not None and channel_mhz is not None:
        raise BadInputError("import", f"{named.instrument} or {named.channel}", "both")
    if is_event_each and average_s is not None:
        raise BadInputError("import", f"{named.average} or {named.events}", "both")
    interval_s = None if is_event_each else average_s or DEFAULT_INTERVAL_S
    opened = open_source(source, station)
    result = average_source(opened, interval_s, choose_channels(opened, instrument, band_mhz, channel_mhz))
    return result.spectra, [*opened.notes, *_describe(result, interval_s)]


def _describe(result: Averaged, interval_s: float | None) -> Iterator[str]:
    if result.channels_left_out.size:
        low, high = result.channels_left_out[[0, -1]]
        yield f"{result.channels_left_out.size} channels between {low:g} and {high:g} MHz are flagged, left out"
    if result.spectra_left_out:
        yield f"{result.spectra_left_out} spectra lack one of the other channels, left out"
    for flag, count in result.flags.items():
        yield f"{count} spectra are flagged {flag!r}: the file keeps them, fits leave them out"
    spectra, channels = result.spectra, result.spectra.frequency_mhz
    of_what = "events" if interval_s is None else f"intervals of {interval_s:g} s"
    yield (
        f"{len(spectra)} spectra, {np.unique(spectra.event_id).size} {of_what} from {result.integrations} "
        f"integrations, {channels.size} channels from {channels[0]:g} to {channels[-1]:g} MHz"
    )
