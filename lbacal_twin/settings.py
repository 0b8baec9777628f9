"""What kind of campaign to simulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnknownNameError
from lbacal_core.grids import Floats

DAY_S = 86_400.0
YEAR_S = 365.25 * DAY_S
START_2014 = datetime(2014, 1, 1, tzinfo=UTC).timestamp()


@dataclass(frozen=True)
class TwinSettings:
    """Size and scatter of a simulated campaign. Scatter is one standard deviation, a fraction of the power.

    Attributes
    ----------
    start_unix, years
        First instant, s UTC, and duration.
    events_per_year
        Air showers at random times of the year.
    stations
        Names; empty for every station of the instrument.
    antennas
        How many antennas of each station, in the order of their numbers; None for all.
    fewest_blocks, most_blocks
        A spectrum averages a number of 1024-sample blocks drawn between these.
    path_gain
        Spread of the gain from path to path, flat along frequency, in front of N_RCU. Station gain tables of
        2013 (512 sub-bands, 96 receivers) spread by 2.8-5.2 %.
    event_gain_common, event_gain_path
        Gain of one event, common to a station and of each path by itself; together 5 %.
    radiometer
        Noise of 1 MHz averaged over 100 blocks: 1/sqrt(100 blocks x 5.12 bins).
    response
        Smooth departure of A(nu) of a station's polarisation from the curve that the published C(nu) implies.
    noise_level
        Spread of the three noise levels from station to station.
    """

    start_unix: float = START_2014
    years: float = 1.0
    events_per_year: int = 900
    stations: tuple[str, ...] = ()
    antennas: int | None = None
    fewest_blocks: int = 100
    most_blocks: int = 100
    path_gain: float = 0.04
    event_gain_common: float = 0.03
    event_gain_path: float = 0.04
    radiometer: float = 512**-0.5
    response: float = 0.03
    noise_level: float = 0.05

    def __post_init__(self) -> None:
        scatters = ("path_gain", "event_gain_common", "event_gain_path", "radiometer", "response", "noise_level")
        for field in scatters:
            self._require(field, 0 <= getattr(self, field) < 0.3, "a fraction, 0 to 0.3")
        self._require("years", self.years > 0, "years > 0")
        self._require("events_per_year", self.events_per_year > 0, "a count > 0")
        self._require("antennas", self.antennas is None or self.antennas > 0, "a count > 0")
        self._require("fewest_blocks", 0 < self.fewest_blocks <= self.most_blocks, "0 < fewest <= most_blocks")

    def _require(self, field: str, is_good: bool, expected: str) -> None:
        if not is_good:
            raise BadInputError(f"twin settings: {field}", expected, repr(getattr(self, field)))

    @property
    def event_count(self) -> int:
        """Number of events of the whole campaign."""
        return max(1, round(self.events_per_year * self.years))

    def as_dict(self) -> dict[str, Any]:
        """Describe the settings as JSON values."""
        return asdict(self) | {"stations": list(self.stations)}


# Everything a campaign hides, apart from the data.


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
