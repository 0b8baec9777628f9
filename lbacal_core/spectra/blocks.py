"""Background spectra as dense arrays: one block per station and dipole, as fits and monthly ratios read them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_arrays
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.spectra.stations import Recorded


@dataclass(frozen=True)
class SpectraBlock:
    """The spectra of one polarisation of a station on a full (antenna, event) grid.

    Attributes
    ----------
    antennas
        Shape (antenna,), the antenna numbers, rising.
    event_id, time_unix
        Shape (event,), in order of time.
    power
        Shape (antenna, event, freq), ADC^2/Ohm/MHz; 1 where nothing was measured.
    is_present
        Shape (antenna, event), whether a spectrum exists.
    blocks
        Shape (antenna, event), 0 where nothing was measured.
    """

    station: str
    dipole: str
    frequency_mhz: Floats
    antennas: NDArray[np.int64]
    event_id: NDArray[np.str_]
    time_unix: Floats
    power: Floats
    is_present: NDArray[np.bool_]
    blocks: NDArray[np.int64]
    environment: Mapping[str, Floats] = field(default_factory=dict)

    def digest(self) -> str:
        """Hash of every value that a fit sees."""
        return hash_arrays(
            [self.station, self.dipole], self.frequency_mhz, self.antennas, self.event_id, self.time_unix, self.power,
            self.is_present, self.blocks,
        )  # fmt: skip


def split_into_blocks(spectra: Recorded) -> list[SpectraBlock]:
    """Lay spectra out as one dense block per station and dipole, stations and dipoles in alphabetical order."""
    return [block for of_part in spectra.each(iterate_blocks) for block in of_part]


def iterate_blocks(spectra: Spectra, station: str | None = None) -> Iterator[SpectraBlock]:
    """The blocks of `split_into_blocks` one by one, of all stations or of one."""
    (stations, station_at), (dipoles, dipole_at) = spectra.key_codes["station"], spectra.key_codes["dipole"]
    for s, name in enumerate(stations.tolist()):
        for d, letter in enumerate(dipoles.tolist()):
            rows = np.flatnonzero((station_at == s) & (dipole_at == d))
            if rows.size and station in (None, name):
                yield _block_of_rows(spectra, rows, name, letter)


def _block_of_rows(spectra: Spectra, rows: NDArray[np.int64], station: str, dipole: str) -> SpectraBlock:
    antennas, antenna_at = np.unique(spectra.antenna[rows], return_inverse=True)
    events, code = spectra.key_codes["event_id"]
    found, first, event_at = np.unique(code[rows], return_index=True, return_inverse=True)
    order = np.lexsort((found, spectra.time_unix[rows][first]))
    event_at = np.argsort(order)[event_at]
    first = rows[first[order]]
    row_at = np.full((antennas.size, found.size), -1)
    row_at[antenna_at, event_at] = rows
    is_present = row_at >= 0
    power = spectra.power[row_at]
    power[~is_present] = 1.0
    return SpectraBlock(
        station=station,
        dipole=dipole,
        frequency_mhz=spectra.frequency_mhz,
        antennas=antennas,
        event_id=events[found[order]],
        time_unix=spectra.time_unix[first],
        power=power,
        is_present=is_present,
        blocks=np.where(is_present, spectra.blocks[row_at], 0),
        environment={name: values[first] for name, values in spectra.environment.items()},
    )
