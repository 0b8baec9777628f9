"""Spectra of an array, of which those of one station at a time are in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.spectra.quarters import Quarters, hash_window, pick_hashes
from lbacal_core.spectra.spectra import Result, Spectra

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
