"""What a reader of a foreign format returns: which paths and channels there are, and integrations in blocks of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_channels
from lbacal_core.instrument.antennas import EXPECTED, are_dipole_names


@dataclass(frozen=True)
class Integrations:
    """Successive integrations of all paths of a source.

    Attributes
    ----------
    time_unix, duration_s
        Middle and length of each integration, shape (time,), s.
    power
        Shape (time, path, freq), any unit of power per MHz; NaN or <= 0 where it was flagged or not recorded.
    event_id
        Names of the integrations, shape (time,), empty where one has none; None where none has.
    flag
        Why an integration must not be used, shape (time,), empty where it may; None where all may.
    environment
        Covariates by name, shape (time,) each.
    """

    time_unix: Floats
    duration_s: Floats
    power: NDArray[np.floating]
    event_id: NDArray[np.str_] | None = None
    flag: NDArray[np.str_] | None = None
    environment: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """Data in a foreign format, of which a part at a time is in memory.

    Attributes
    ----------
    name
        The file or folder, for messages.
    frequency_mhz, width_mhz
        Centres (rising) and widths of the channels, shape (freq,), MHz.
    station, antenna, dipole
        Which path each column of the power is, shape (path,).
    read
        Yields the integrations in order of time.
    notes
        What a user must know about the data, one sentence each.
    """

    name: str
    frequency_mhz: Floats
    width_mhz: Floats
    station: NDArray[np.str_]
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    read: Callable[[], Iterator[Integrations]]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_channels(self.name, self.frequency_mhz)
        if self.antenna.size == 0:
            raise BadInputError(self.name, "at least one path (antenna and dipole)", "none")
        bad = np.flatnonzero(~are_dipole_names(self.dipole))
        if bad.size:
            raise BadInputError(f"{self.name}: dipole of path {bad[0]}", EXPECTED, repr(str(self.dipole[bad[0]])))
        paths = list(zip(self.station.tolist(), self.antenna.tolist(), self.dipole.tolist(), strict=True))
        twice = [path for path, count in Counter(paths).items() if count > 1]
        if twice:
            raise BadInputError(self.name, "each path once", f"{twice[0][0]} antenna {twice[0][1]} {twice[0][2]} twice")
