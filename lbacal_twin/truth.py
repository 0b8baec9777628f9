"""Everything a campaign hides, apart from the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class StationTruth:
    """The planted values of one station.

    Attributes
    ----------
    antennas
        Shape (antenna,).
    c
        C(nu) of every path with the cable of the first event, without any fault; shape (antenna, dipole, freq).
    path_gain
        Shape (antenna, dipole).
    n_lna, n_rcu, n_adc
        In the units of a fit: of P_sky, and power at the output (N_RCU S and N_ADC); with stages, about what theirs
        add up to.
    constants
        The constants of stages by name; None where the instrument has no stages.
    """

    station: str
    antennas: NDArray[np.int64]
    c: Floats
    path_gain: Floats
    n_lna: float
    n_rcu: float
    n_adc: float
    constants: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Truth:
    """The planted values of a campaign."""

    settings: Mapping[str, Any]
    frequency_mhz: Floats
    stations: Sequence[StationTruth]
    faults: Sequence[Mapping[str, Any]] = ()
    dipoles: tuple[str, ...] = ("X", "Y")

    def curve(self, dipole: str, station: str | None = None, antenna: int | None = None) -> Floats:
        """C(nu) of one path, of a station or of the array.

        Antennas are averaged as the measurement averages them, in power: C of a station or of the array is that of
        the mean power gain of its paths, 1/C^2 = mean(g A L G_RCU S).
        """
        chosen = [one for one in self.stations if station in (None, one.station)]
        if not chosen:
            raise UnknownNameError("station", str(station), [one.station for one in self.stations])
        k = self.dipoles.index(dipole)
        gains = [
            one.c[one.antennas == antenna, k] ** -2 if antenna is not None else one.c[:, k] ** -2 for one in chosen
        ]
        stacked = np.concatenate(gains)
        if not len(stacked):
            raise UnknownNameError("antenna", str(antenna), [str(number) for number in chosen[0].antennas])
        return np.asarray(stacked.mean(axis=0) ** -0.5)
