"""Station statistics of NenuFAR: the power of every mini-array, polarisation and sub-band, once a second (SST).

The layout is the one that the package nenupy 2.8.5 reads (`nenupy.io.sst`, `nenupy.io.io_tools`): FITS, whose first
extension holds the frequencies `frq` (MHz, middle of the sub-bands), the mini-arrays `noMROn` and the names `spol` of
the polarisations (NW, NE), and whose seventh holds `JD` and `data`, shape (time, mini-array, polarisation, sub-band).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.readers.source import Integrations, Source

SUFFIXES = (".fits", ".fit")
INSTRUMENT, DATA = 1, 7
"""Numbers of the extensions."""
WIDTH_MHZ = 0.1953125
SECOND = 1.0
AT_ONCE = 60
DAY_S, UNIX_EPOCH_JD = 86_400.0, 2440587.5
STATION = "NenuFAR"
FAILURES = (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError)
"""What astropy raises on broken files."""


def open_mini_arrays(path: Path, station: str | None = None) -> Source:
    """Open a file of NenuFAR's sub-band statistics; a mini-array is an antenna, NW and NE are its dipoles."""
    from astropy.io import fits

    try:
        with fits.open(path, memmap=True) as file:
            facts, rows = file[INSTRUMENT].data, file[DATA].data
            frequency = np.asarray(facts["frq"][0], dtype=float)
            antennas = np.asarray(facts["noMROn"][0], dtype=np.int64)
            letters = np.array([str(name).strip() for name in np.atleast_1d(facts["spol"][0])])
            time = (np.asarray(rows["JD"], dtype=float) - UNIX_EPOCH_JD) * DAY_S
            shape = rows["data"].shape
    except FAILURES as error:
        raise UnreadableFileError(f"{path}: expected NenuFAR's statistics (FITS): {str(error)[:120]}") from error
    expected = (time.size, antennas.size, letters.size, frequency.size)
    if shape != expected or time.size == 0:
        raise BadInputError(f"{path}: data", f"shape {expected} (time, mini-array, polarisation, sub-band)", f"{shape}")
    if np.any(np.diff(time) <= 0):
        raise BadInputError(f"{path}: JD", "instants in order of time", "others")
    order = np.argsort(frequency)
    return Source(
        name=path.name,
        frequency_mhz=frequency[order],
        width_mhz=np.full(frequency.size, WIDTH_MHZ),
        station=np.full(antennas.size * letters.size, station or STATION),
        antenna=np.repeat(antennas, letters.size),
        dipole=np.tile(letters, antennas.size),
        read=lambda: _read(path, time, order),
        notes=(
            "the unit of the power is the station's: C becomes relative",
            "an antenna is a mini-array of 19: the pattern of the instrument must be its, where its beam pointed",
            "the arm of NE points to 45 deg, that of NW to 135 deg",
        ),
    )


def _read(path: Path, time: NDArray[np.float64], order: NDArray[np.int64]) -> Iterator[Integrations]:
    from astropy.io import fits

    length = np.full(time.size, np.median(np.diff(time)) if time.size > 1 else SECOND)
    with fits.open(path, memmap=True) as file:
        data = file[DATA].data["data"]
        for start in range(0, time.size, AT_ONCE):
            rows = slice(start, start + AT_ONCE)
            block = np.asarray(data[rows], dtype=float)[..., order]
            yield Integrations(time[rows] + length[rows] / 2, length[rows], block.reshape(len(block), -1, order.size))
