"""Which reader a file or folder needs, and the channels that a user wants of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import guess_widths
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.readers import correlator, statistics, tables, visibilities
from lbacal_core.readers.source import Channels, Source

FORMATS = (
    "visibilities (.uvh5, .uvfits, measurement sets)",
    "LOFAR 2.0 sub-band statistics (.h5)",
    "NenuFAR sub-band statistics (.fits)",
    "correlator files of SKA-Low's test stations (.hdf5), or a folder of them, one a channel",
    "a .csv table with a row an integration and path",
    "a folder of LOFAR's ..._sst_rcuNNN.dat",
    "a folder of .csv or .npz files, one an integration",
)
DEFAULT_STATION = "ST001"


def open_source(path: Path, station: str | None = None) -> Source:
    """Open data in any of the formats in `FORMATS`.

    Parameters
    ----------
    station
        Name of the station where the data have none.
    """
    opened = _open(path, station)
    if station is None and DEFAULT_STATION in opened.station:
        called = f"the data name no station: it is called {DEFAULT_STATION} (--station gives its name)"
        opened = replace(opened, notes=(called, *opened.notes))
    return opened


def _open(path: Path, station: str | None) -> Source:
    if path.is_dir():
        return _open_folder(path, station or DEFAULT_STATION)
    if not path.is_file():
        raise UnreadableFileError(f"{path}: no such file or folder")
    if path.suffix in visibilities.SUFFIXES:
        return visibilities.open_visibilities(path)
    if statistics.is_statistics(path):
        return statistics.open_statistics(path)
    if correlator.is_correlator_file(path):
        return correlator.open_correlator([path], path.name, station or DEFAULT_STATION)
    if path.suffix in statistics.NENUFAR_SUFFIXES:
        return statistics.open_mini_arrays(path, station)
    if path.suffix in tables.SUFFIXES:
        return tables.open_file(path, station or DEFAULT_STATION)
    raise BadInputError(str(path), "; ".join(FORMATS), f"a file {path.suffix or 'without a suffix'}")


def _open_folder(path: Path, station: str) -> Source:
    if visibilities.is_measurement_set(path):
        return visibilities.open_visibilities(path)
    receivers = statistics.find_receiver_files(path)
    if receivers:
        return statistics.open_receiver_files(receivers, station)
    correlated = sorted(file for file in path.glob(f"*{correlator.SUFFIX}") if correlator.is_correlator_file(file))
    if correlated:
        return correlator.open_correlator(correlated, path.name, station)
    files = sorted(file for file in path.iterdir() if file.suffix in tables.SUFFIXES)
    if not files:
        raise BadInputError(str(path), "; ".join(FORMATS), "a folder without any of them")
    return tables.open_folder(files, station)


def choose_channels(
    source: Source,
    instrument: Instrument | None = None,
    band_mhz: tuple[float, float] | None = None,
    width_mhz: float | None = None,
) -> Channels:
    """The channels to average a source to: those of an instrument, or of one width, or its own; within a band.

    Channels of one width lie at multiples of it.
    """
    if instrument is not None:
        frequency, width = instrument.frequency_mhz, guess_widths(instrument.frequency_mhz)
    elif width_mhz is not None:
        first = np.ceil((source.frequency_mhz[0] - source.width_mhz[0] / 2) / width_mhz + 0.5)
        last = np.floor((source.frequency_mhz[-1] + source.width_mhz[-1] / 2) / width_mhz - 0.5)
        frequency = np.arange(first, last + 1) * width_mhz
        width = np.full(frequency.size, width_mhz)
    else:
        frequency, width = source.frequency_mhz, source.width_mhz
    if band_mhz is not None:
        is_inside = (frequency >= band_mhz[0]) & (frequency <= band_mhz[1])
        frequency, width = frequency[is_inside], width[is_inside]
    if frequency.size == 0:
        low, high = source.frequency_mhz[[0, -1]]
        raise BadInputError(f"{source.name}: channels", f"some between {low:g} and {high:g} MHz", "none")
    return Channels(frequency, width)
