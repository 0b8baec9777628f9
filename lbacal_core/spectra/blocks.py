"""Spectra read station by station, and as dense arrays: one block per station and dipole, as fits read them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_arrays
from lbacal_core.spectra.spectra import Quarters, Result, Spectra, hash_window, pick_hashes

Spread = Callable[[Callable[[Spectra], Any], Iterable[Spectra]], Iterable[Any]]
"""`map`, or what does the same in other processes."""


@dataclass(frozen=True)
class SpectraByStation:
    """Spectra that are read station by station, each as often as it is needed: always the same.

    Attributes
    ----------
    names
        Stations, in alphabetical order.
    read
        Reads the spectra of a station, of which only blocks tell how long they were recorded.
    head
        The same without a row.
    span_unix, blocks, quarter_hashes
        As in `Spectra`, of all.
    """

    names: Sequence[str]
    read: Callable[[str], Spectra]
    spread: Spread
    head: Spectra
    span_unix: tuple[float, float]
    blocks: NDArray[np.int64]
    quarter_hashes: Quarters
    duration_s: None = None

    @classmethod
    def of(cls, names: Sequence[str], read: Callable[[str], Spectra], spread: Spread = map) -> SpectraByStation:
        """Read all of them for a first time."""

        def tell(own: Spectra) -> tuple[Spectra, tuple[float, float], NDArray[np.int64], Quarters]:
            blocks = own.blocks.astype(np.min_scalar_type(own.blocks.max(initial=0)))  # a byte or two a spectrum
            return own.select(np.zeros(0, dtype=np.int64)), own.span_unix, blocks, own.quarter_hashes

        heads, spans, blocks, quarters = zip(*map(tell, map(read, names)), strict=True)
        span = min(first for first, _ in spans), max(last for _, last in spans)
        hashes = {path: found for one in quarters for path, found in one.items()}
        return cls(names, read, spread, heads[0], span, np.concatenate(blocks), hashes)

    def __len__(self) -> int:
        return self.blocks.size

    def each(self, function: Callable[[Spectra], Result]) -> Iterable[Result]:
        """Call a function with the spectra of one station after the other."""
        return self.spread(function, map(self.read, self.names))

    def change(self, function: Callable[[Spectra], Spectra]) -> SpectraByStation:
        """Make other spectra of those of each station, whenever they are read."""
        return self.of(self.names, lambda name: function(self.read(name)), self.spread)

    @cached_property
    def environment(self) -> Mapping[str, Floats]:
        """Covariates by name, shape (row,), NaN where unknown."""
        parts = [(len(own), own.environment) for own in map(self.read, self.names)]
        names = sorted({name for _, own in parts for name in own})
        return {name: np.concatenate([own.get(name, np.full(size, np.nan)) for size, own in parts]) for name in names}

    def digest(self, station: str | None = None, antenna: int | None = None, dipole: str | None = None) -> str:
        """As of spectra that are in memory."""
        head, hashes = self.head, pick_hashes(self.quarter_hashes, station, antenna, dipole)
        return hash_window(head.frequency_mhz, head.resistance_ohm, head.width_mhz, hashes)


Recorded = Spectra | SpectraByStation
AnySpectra = TypeVar("AnySpectra", Spectra, Recorded)


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
