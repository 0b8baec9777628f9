"""Autocorrelations from the correlator files of SKA-Low's test stations (AAVS, EDA2), one frequency channel a file.

The layout is that of the station's acquisition software (aavs-system, `pydaq/persisters/aavs_file.py` and `corr.py`) as
ska-sci-ops/aa_uv reads it (`aa_uv/io/to_uvx.py`, `to_pyuvdata.py`): `correlation_matrix/data` has the axes (time,
channel, baseline, stokes), stokes XX, XY, YX, YY; `sample_timestamps/data` is when each integration begins (s UTC); the
attributes of the dataset `root` are `n_antennas`, `n_baselines`, `channel_id`, `tsamp` (s) and more. Channel k lies at
k x 400/512 MHz. Baselines stand in the order of `numpy.triu_indices`; of an autocorrelation XX and YY are real.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from lbacal_core.errors import BadInputError, reading
from lbacal_core.grids import Floats
from lbacal_core.hdf5 import HDF5_FAILURES
from lbacal_core.readers.source import Integrations, Source

SUFFIX = ".hdf5"
CHANNEL_MHZ = 400.0 / 512
"""Spacing of the channels; each is 32/27 as wide, since they overlap (`channel_width` of aa_uv's configurations)."""
DATA, TIMES = "correlation_matrix/data", "sample_timestamps/data"
XX, YY = 0, 3
ROUNDING = 1e-6
"""Imaginary over real part of a number of 4 bytes that is real."""
AT_ONCE = 32
"""Integrations in memory: of 256 antennas 34 MB."""


@dataclass(frozen=True)
class _Recording:
    """One file: its channel and number of antennas, and the beginnings and length of its integrations, s."""

    path: Path
    channel: int
    antennas: int
    begin: Floats
    length: float


def is_correlator_file(path: Path) -> bool:
    """Whether a file is HDF5 with a correlation matrix."""
    if not (path.is_file() and h5py.is_hdf5(path)):
        return False
    with h5py.File(path, "r") as file:
        return DATA in file


def open_correlator(files: Sequence[Path], name: str, station: str) -> Source:
    """Open correlator files of one station, each of one channel.

    Parameters
    ----------
    name
        What they are called together, for messages.
    station
        Its name, which the files do not have.
    """
    recordings = sorted((_describe(path) for path in files), key=lambda one: (one.begin[0], one.channel))
    antennas = {one.antennas for one in recordings}
    if len(antennas) > 1:
        raise BadInputError(name, "files of one station", f"{' and '.join(map(str, sorted(antennas)))} antennas")
    count, channels = antennas.pop(), sorted({one.channel for one in recordings})
    return Source(
        name=name,
        frequency_mhz=np.array(channels) * CHANNEL_MHZ,
        width_mhz=np.full(len(channels), CHANNEL_MHZ),
        station=np.full(2 * count, station),
        antenna=np.repeat(np.arange(count), 2),
        dipole=np.tile(["X", "Y"], count),
        read=lambda: _read(recordings, channels),
        notes=("the unit of the power is the correlator's: C becomes relative",),
    )


def _describe(path: Path) -> _Recording:
    with reading(f"{path}: expected a file of the correlator", *HDF5_FAILURES), h5py.File(path, "r") as file:
        data, facts = file[DATA], file["root"].attrs
        begin = np.ravel(file[TIMES][()])[: data.shape[0]].astype(float)
        found = _Recording(path, int(facts["channel_id"]), int(facts["n_antennas"]), begin, float(facts["tsamp"]))
        expected = (begin.size, 1, found.antennas * (found.antennas + 1) // 2, 4)
        first = data[:1] if data.shape == expected and begin.size else None
    if first is None:
        raise BadInputError(f"{path}: {DATA}", f"shape {expected} (time, channel, baseline, stokes)", f"{data.shape}")
    if not (found.length > 0 and np.all(begin > 0)):
        raise BadInputError(f"{path}: tsamp, {TIMES}", "seconds > 0", f"{found.length:g} and {begin.min():g}")
    of_baseline = first[0, 0][:, [XX, YY]]
    is_real = np.all(np.abs(of_baseline.imag) <= ROUNDING * np.abs(of_baseline.real), axis=1)
    is_auto = np.isin(np.arange(is_real.size), _autocorrelations(found.antennas))
    # what a dead antenna did not record is zero, and real, on all its baselines
    is_auto_like = is_real & (is_auto | np.any(of_baseline != 0, axis=1))
    if not np.array_equal(is_auto_like, is_auto):
        raise BadInputError(
            f"{path}: {DATA}",
            f"{found.antennas} autocorrelations, whose XX and YY are real, in the order of the upper triangle",
            f"{is_auto_like.sum()} baselines with real XX and YY, {np.sum(is_auto_like & is_auto)} of them there",
        )
    return found


def _autocorrelations(antennas: int) -> np.ndarray:
    """Which baselines are those of an antenna with itself, shape (antenna,)."""
    one, other = np.triu_indices(antennas)
    return np.flatnonzero(one == other)


def _read(recordings: Sequence[_Recording], channels: Sequence[int]) -> Iterator[Integrations]:
    for one in recordings:
        autos, at = _autocorrelations(one.antennas), channels.index(one.channel)
        for start in range(0, one.begin.size, AT_ONCE):
            begin = one.begin[start : start + AT_ONCE]
            with reading(f"{one.path}: {DATA} cannot be read", *HDF5_FAILURES), h5py.File(one.path, "r") as file:
                measured = file[DATA][start : start + AT_ONCE, 0].real[:, autos][:, :, [XX, YY]]
            power = np.full((begin.size, 2 * one.antennas, len(channels)), np.nan)
            power[:, :, at] = measured.reshape(begin.size, -1)
            yield Integrations(begin + one.length / 2, np.full(begin.size, one.length), power)
