"""What a station should see of the sky at any place, with any arms and clock; and how other models would differ.

Each exchange of a model for another is one standard deviation of what is known. Without them a clock would be off by
several minutes: so much differ the times at which the Galaxy culminates in antenna models.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lbacal_core.audit.series import Seen
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sky.frames import DATA_EPOCH
from lbacal_core.sky.multipoles import Complexes, precess_multipoles
from lbacal_core.sky.names import DEFAULT_TO_MHZ, default_sky, load_sky
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.differences import WIDE_MODELS, DifferenceModels, list_patterns
from lbacal_core.skypower.modes import combine, sky_power_at

Exchange = tuple[int, int]
"""Numbers of a sky and an antenna; 0 is the station's own."""


@dataclass
class SkyModels:
    """P_sky of all models in the bands of a series.

    Attributes
    ----------
    temperatures
        Multipoles of each sky, the own one first, shape (band, l, m).
    patterns
        Multipoles of each antenna by tilt of the arm, the own one first, shape (band, l, m').
    """

    instrument: Instrument
    frequency_mhz: Floats
    temperatures: list[Complexes]
    patterns: dict[float, list[Complexes]]
    _modes: dict[tuple[Exchange, float, float, str], Complexes] = field(default_factory=dict)

    def seen(self, lst_hours: Floats, latitude_deg: float, turned_deg: float = 0.0) -> Seen:
        """What the station should see if it stood at a latitude with all arms turned, and how models differ in it."""

        def change(exchange: Exchange) -> Floats:
            power = np.stack(
                [
                    sky_power_at(self._modes_of(exchange, latitude_deg, turned_deg, dipole), lst_hours).T
                    for dipole in self.instrument.dipoles
                ]
            )
            return np.asarray(power / power.mean(axis=-1, keepdims=True) - 1.0)

        own = change((0, 0))
        antennas = len(next(iter(self.patterns.values())))
        exchanges = [(sky, 0) for sky in range(1, len(self.temperatures))] + [(0, k) for k in range(1, antennas)]
        differences = [change(one) - own for one in exchanges]
        return Seen(own, np.array(differences).reshape(-1, *own.shape))

    def _modes_of(self, exchange: Exchange, latitude_deg: float, turned_deg: float, dipole: str) -> Complexes:
        key = (exchange, latitude_deg, turned_deg, dipole)
        if key not in self._modes:
            sky, antenna = exchange
            pattern = self.patterns[self.instrument.tilt_deg(dipole)][antenna]
            arm = self.instrument.dipole_azimuth_deg[dipole] + turned_deg
            self._modes[key] = combine(self.temperatures[sky], pattern, arm, latitude_deg, self.frequency_mhz)
        return self._modes[key]


def load_models(
    instrument: Instrument,
    frequency_mhz: Floats,
    sky: str | None,
    antenna: str | None,
    others: DifferenceModels | None = None,
) -> SkyModels:
    """The sky and antenna that are named, else those of the instrument, and the models that they are exchanged for.

    Parameters
    ----------
    others
        All models that ship unless given.
    """
    name = sky or instrument.sky or default_sky(frequency_mhz)
    is_wide = frequency_mhz.max() > DEFAULT_TO_MHZ
    others = others or (WIDE_MODELS if is_wide else DifferenceModels())
    loaded = [load_sky(one) for one in (name, *(one for one in others.skies if one != name))]
    lmax = min(one.lmax for one in loaded)
    skies = [one.truncated(lmax) for one in loaded]
    named = replace(instrument, antenna=antenna or antenna_of(instrument))
    low = max(one.frequency_mhz[0] for one in skies)
    high = min(one.frequency_mhz[-1] for one in skies)
    inside = np.clip(frequency_mhz, low, high)
    patterns = {}
    for tilt in {instrument.tilt_deg(dipole) for dipole in instrument.dipoles}:
        plain, rest = list_patterns(named, others, inside, lmax, tilt)
        patterns[tilt] = [plain, *rest]
    temperatures = [precess_multipoles(one.temperature(inside), DATA_EPOCH) for one in skies]
    return SkyModels(instrument, frequency_mhz, temperatures, patterns)
