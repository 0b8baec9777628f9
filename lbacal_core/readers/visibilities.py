"""Autocorrelations of an interferometer (uvh5, FITS-UV, measurement sets), read by pyuvdata."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError, MissingExtraError, needing, reading
from lbacal_core.grids import DAY_S, JULIAN_DATE_OF_1970
from lbacal_core.readers.source import Integrations, Source

SUFFIXES = (".uvh5", ".uvfits")
TIMES_AT_ONCE = 32
_LETTERS = {-5: "X", -6: "Y"}
"""AIPS numbers of the linear autocorrelations XX and YY (AIPS memo 117)."""


def is_measurement_set(path: Path) -> bool:
    """Whether a folder is a table of casacore, as a measurement set is (its file `table.dat`)."""
    return (path / "table.dat").is_file()


def open_visibilities(path: Path) -> Source:
    """Open a file of visibilities; only its autocorrelations are read.

    The x feed of pyuvdata becomes X, y becomes Y; their angles, north through east, are the azimuths of the arms.
    """
    with needing(f"reading {path.name}", "import"):
        from pyuvdata import UVData
    if path.is_dir() and find_spec("casacore") is None:
        raise MissingExtraError(f"reading the measurement set {path.name}", "casa")
    with reading(f"{path}: pyuvdata cannot read it", OSError, RuntimeError, ValueError, KeyError, IndexError):
        data = UVData()
        data.read(str(path), read_data=False, run_check=False)
    letters = [_LETTERS.get(int(number)) for number in data.polarization_array]
    if not any(letters):
        raise BadInputError(f"{path}: polarisations", "XX or YY", f"{list(data.polarization_array)}")
    antennas = np.unique(data.ant_1_array[data.ant_1_array == data.ant_2_array])
    if antennas.size == 0:
        raise BadInputError(str(path), "autocorrelations", "cross-correlations only")
    polarisations = [k for k, letter in enumerate(letters) if letter]
    telescope = data.telescope
    frequency_hz = np.ravel(data.freq_array)
    order = np.argsort(frequency_hz)
    return Source(
        name=path.name,
        frequency_mhz=frequency_hz[order] / 1e6,
        width_mhz=np.broadcast_to(np.ravel(data.channel_width), frequency_hz.shape)[order] / 1e6,
        station=np.full(antennas.size * len(polarisations), str(telescope.name)),
        antenna=np.repeat(antennas, len(polarisations)).astype(np.int64),
        dipole=np.tile([str(letters[k]) for k in polarisations], antennas.size),
        read=lambda: _read(path, np.unique(data.time_array), antennas, polarisations, order),
        notes=_describe(data),
        arms_deg=_find_arms(path, data.telescope),
    )


def _describe(data: Any) -> tuple[str, ...]:
    telescope = data.telescope
    latitude, longitude, height = telescope.location_lat_lon_alt_degrees
    notes = [f"{telescope.name} stands at {latitude:.4f} deg north, {longitude:.4f} deg east, {height:.0f} m"]
    units = data.vis_units
    if units not in ("K", "Jy"):
        notes.append(f"the unit of the power is the correlator's ({units}): C becomes relative")
    return tuple(notes)


def _find_arms(path: Path, telescope: Any) -> dict[str, float]:
    """Azimuths of the arms by dipole, deg, empty where the file does not say: the feed angles of all antennas."""
    if telescope.feed_angle is None:
        return {}
    feeds, angle = np.asarray(telescope.feed_array), np.degrees(telescope.feed_angle)
    arms = {feed.upper(): np.unique(np.round(angle[feeds == feed], 3)) for feed in ("x", "y") if np.any(feeds == feed)}
    unlike = [letter for letter, found in arms.items() if found.size > 1]
    if unlike:
        found = f"{arms[unlike[0]].min():g} to {arms[unlike[0]].max():g} deg"
        raise BadInputError(f"{path}: arm of {unlike[0]}", "the same azimuth for all antennas", found)
    return {letter: float(found[0]) for letter, found in arms.items()}


def _read(
    path: Path, times: np.ndarray, antennas: np.ndarray, polarisations: list[int], order: np.ndarray
) -> Iterator[Integrations]:
    from pyuvdata import UVData

    # of a measurement set pyuvdata reads the whole, whatever is asked for: once is enough
    at_once = times.size if path.is_dir() else TIMES_AT_ONCE
    for start in range(0, times.size, at_once):
        data = UVData()
        wanted = times[start : start + at_once]
        data.read(str(path), times=wanted, ant_str="auto", run_check=False)
        at = np.searchsorted(wanted, data.time_array)
        row = np.searchsorted(antennas, data.ant_1_array)
        power = np.full((wanted.size, antennas.size, len(polarisations), order.size), np.nan)
        measured = np.where(data.flag_array, np.nan, data.data_array.real)[:, order][:, :, polarisations]
        power[at, row] = measured.swapaxes(1, 2)
        length = np.zeros(wanted.size)
        length[at] = data.integration_time
        yield Integrations((wanted - JULIAN_DATE_OF_1970) * DAY_S, length, power.reshape(wanted.size, -1, order.size))
