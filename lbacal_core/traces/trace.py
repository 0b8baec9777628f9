"""One dipole's raw trace: its header, and its samples in blocks of 1024."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError

BLOCK_SAMPLES = 1024
"""Samples of a block (5.12 us at 200 MHz), which is also what one TBB frame holds."""

ADC_LOWEST, ADC_HIGHEST = -2048, 2047
"""Range of the 12-bit converters (van Haarlem et al. 2013, A&A 556, A2, section 4.2)."""

UNKNOWN_ANTENNA_SET = "UNDEFINED"
INNER, OUTER = "inner", "outer"
FIELDS = {
    "LBA_INNER": (INNER, INNER),
    "LBA_OUTER": (OUTER, OUTER),
    "LBA_SPARSE_EVEN": (INNER, OUTER),
    "LBA_SPARSE_ODD": (OUTER, INNER),
}
"""Antenna field of the even and of the odd antennas in each set (AntennaSets.conf of the observatory: inputs h are the
inner field, inputs l the outer one)."""
ONE_LETTER = {"LBA_X": "X", "LBA_Y": "Y"}
"""Sets in which every receiver has the same letter."""
ANTENNA_SETS = (*FIELDS, *ONE_LETTER)

_CORE_STATIONS = frozenset({101, 103, 201, 301, 302, 401, 501})
_COUNTRIES = {
    **dict.fromkeys((601, 602, 603, 604, 605, 609), "DE"),
    606: "FR",
    607: "SE",
    608: "UK",
    **dict.fromkeys((610, 611, 612), "PL"),
    613: "IE",
    614: "LV",
}


def name_station(station_id: int) -> str:
    """Name of a station from the number in a TBB header.

    The number is one byte, so stations beyond 100 are packed: CS302 is 142, RS508 is 188, DE601 is 201;
    hundreds count by 20 from 101. A number that names no station known here still gives a name.
    """
    number = station_id if station_id <= 100 else 100 * (1 + (station_id - 101) // 20) + (station_id - 101) % 20 + 1
    country = "CS" if number < 100 or number in _CORE_STATIONS else _COUNTRIES.get(number, "RS")
    return f"{country}{number:03d}"


def name_dipole(rcu: int, antenna_set: str) -> str:
    """Dipole on a receiver (RCU): X on even and Y on odd numbers of the inner field, the reverse in the outer field.

    X is the arm from north-east to south-west, Y from north-west to south-east. In the outer field the two are
    connected the other way round, which the stations undo for their beams (`rspctl --swapxy=1` in modes 1 and 2,
    LOFAR station scripts, Norden and Romein 2011) but not in the transient buffers (LoLIM `raw_tbb_IO`, Hare). The
    cross-correlations of a station show it for every antenna (docs/explanation/x-and-y.md). Where the set is not on
    record the receivers' own labels hold.
    """
    if antenna_set in ONE_LETTER:
        return ONE_LETTER[antenna_set]
    field = FIELDS.get(antenna_set, (INNER, INNER))[rcu // 2 % 2]
    return "X" if (rcu % 2 == 0) == (field == INNER) else "Y"


def require_antenna_set(name: str | None) -> None:
    """Refuse the name of an antenna set whose letters are not known: the receivers' own would hold in silence."""
    if name is not None and name not in ANTENNA_SETS:
        raise BadInputError("antenna set", f"one of {', '.join(ANTENNA_SETS)}", repr(name))


@dataclass(frozen=True)
class TraceReference:
    """The place and the header of one dipole's trace; its samples are not in memory.

    Attributes
    ----------
    dataset
        Path inside an HDF5 file, or the RCU in a file of raw frames.
    start_s, start_sample
        UTC second of the first sample, and its number within that second.
    antenna_set
        One of `ANTENNA_SETS`, of the high band, or `UNDEFINED` where the file does not state it.
    """

    path: Path
    dataset: str
    station: str
    rcu: int
    start_s: int
    start_sample: int
    sample_rate_hz: float
    antenna_set: str = UNKNOWN_ANTENNA_SET

    def __post_init__(self) -> None:
        if not 0 <= self.rcu < 192:
            raise BadInputError(f"{self.path}: RCU", "a receiver 0 to 191", str(self.rcu))
        if not 1e6 <= self.sample_rate_hz <= 1e10:
            raise BadInputError(f"{self.path}: sample rate", "1 MHz to 10 GHz", f"{self.sample_rate_hz:g} Hz")

    @property
    def time_unix(self) -> float:
        """Instant of the first sample, s UTC."""
        return self.start_s + self.start_sample / self.sample_rate_hz

    @property
    def antenna(self) -> int:
        """Number of the antenna in its station, 0 to 47: two receivers an antenna."""
        return self.rcu // 2

    @property
    def dipole(self) -> str:
        """X or Y."""
        return name_dipole(self.rcu, self.antenna_set)

    @property
    def name(self) -> str:
        """The path in words."""
        return f"{self.station} antenna {self.antenna} {self.dipole} (RCU {self.rcu})"


@dataclass(frozen=True)
class Trace:
    """The samples of one dipole in blocks.

    Attributes
    ----------
    samples
        Shape (block, 1024), int16, ADC units; only blocks that exist.
    position
        Shape (block,), strictly rising: blocks since the UTC second of the reference. Gaps are lost blocks.
    is_intact
        Shape (block,): nothing is known against the block.
    faults
        What is wrong with the trace, by name, with counts.
    """

    reference: TraceReference
    samples: NDArray[np.int16]
    position: NDArray[np.int64]
    is_intact: NDArray[np.bool_]
    faults: Mapping[str, int]

    def __post_init__(self) -> None:
        blocks = len(self.samples)
        if self.samples.shape != (blocks, BLOCK_SAMPLES) or blocks == 0:
            expected = f"at least one block of {BLOCK_SAMPLES} samples"
            raise BadInputError(f"{self.reference.path}: samples", expected, f"shape {self.samples.shape}")
        if self.position.shape != (blocks,) or self.is_intact.shape != (blocks,):
            raise BadInputError(f"{self.reference.path}: position, is_intact", f"{blocks} entries", "another count")
        if np.any(np.diff(self.position) <= 0):
            raise BadInputError(f"{self.reference.path}: position", "rising block numbers", "repeated or falling ones")
