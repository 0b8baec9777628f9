"""What P_sky would be with other antennas than the one that an instrument names.

What they change most is the level of P_sky, by a factor of 2 and more where a dipole stands half a wavelength above the
ground. The fit absorbs a level in A(nu), which is free, so that C is wrong by its root where the antenna is another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.constants import speed_of_light

from lbacal_core.antenna.ideal import QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.model import compute_sky_power

PHASES = np.linspace(1.0, 3.0, 11)
"""Heights of short dipoles, k h at the highest channel: 0.6 to 1.8 m at 80 MHz. At pi the zenith is dark."""
SAME = 0.01
"""An antenna that changes P_sky by less, r.m.s., is the same."""


@dataclass(frozen=True)
class OtherAntenna:
    """Another antenna.

    Attributes
    ----------
    change
        By dipole, ln of P_sky with it over P_sky, shape (lst, freq), on a regular grid of the sidereal day from 0 h.
    share
        Its probability among the others before the data are asked: kinds are alike, and so are heights of one kind.
    """

    name: str
    change: Mapping[str, Floats]
    share: float = 1.0


def exchange_antennas(
    instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats, antennas: Mapping[str, str | AntennaModel]
) -> Iterator[OtherAntenna]:
    """What antennas make of P_sky, by dipole, shape (lst, freq); those that change nothing are left out."""
    own = load_antenna(antenna_of(instrument)).name
    for name, antenna in antennas.items():
        try:
            other = compute_sky_power(instrument, antenna=antenna, lst_hours=lst_hours).power
        except BadInputError:
            # a pattern that is not known at these channels or for a tilted arm
            continue
        change = {dipole: np.log(other[dipole] / one) for dipole, one in power.items()}
        if name != own and max(float(np.sqrt(np.mean(one**2))) for one in change.values()) > SAME:
            yield OtherAntenna(name, change)


def list_other_antennas(instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats) -> list[OtherAntenna]:
    """Dipoles over lossy ground and over a conducting plane, at heights between which data cannot tell."""
    wavenumber = 2.0 * np.pi * 1e6 * float(instrument.frequency_mhz.max()) / speed_of_light
    heights = (PHASES / wavenumber).tolist()
    kinds: list[dict[str, str | AntennaModel]] = [
        {"hamaker": "hamaker"},
        {"quarter-wave": QuarterWaveDipole()},
        {f"a short dipole at {height:.2f} m": ShortDipole(height_m=height) for height in heights},
    ]
    found = [list(exchange_antennas(instrument, power, lst_hours, kind)) for kind in kinds]
    count = sum(len(kind) > 0 for kind in found)
    return [replace(one, share=1.0 / count / len(kind)) for kind in found for one in kind]
