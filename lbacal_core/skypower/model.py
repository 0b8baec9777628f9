"""The package's own P_sky: a sky model seen by an antenna model where an instrument stands."""

from __future__ import annotations

import numpy as np

from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import DEFAULT_ANTENNA, load_antenna
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import DEFAULT_SKY, load_sky
from lbacal_core.skypower.modes import sky_power_at, sky_power_modes
from lbacal_core.skypower.table import SkyPower

LST_HOURS = np.arange(96) / 4.0
"""The default grid; P_sky has so few Fourier terms that it is exact between these points as well."""


def compute_sky_power(
    instrument: Instrument,
    sky: str | SkyModel = DEFAULT_SKY,
    antenna: str | AntennaModel = DEFAULT_ANTENNA,
    lst_hours: Floats | None = None,
) -> SkyPower:
    """P_sky(LST, nu) of both dipoles for the instrument's place, arms and channels.

    Parameters
    ----------
    sky, antenna
        A model, or the name or file of one.
    lst_hours
        Shape (lst,), hours, regular over the sidereal day; default 96 from 0.

    Returns
    -------
    Directional sky power, W m^-2 MHz^-1 for R_r = 50 ohm.
    """
    sky_model = load_sky(sky) if isinstance(sky, str) else sky
    antenna_model = load_antenna(antenna) if isinstance(antenna, str) else antenna
    lst = LST_HOURS if lst_hours is None else np.asarray(lst_hours, dtype=float)
    power = {
        dipole: sky_power_at(
            sky_power_modes(sky_model, antenna_model, arm, instrument.latitude_deg, instrument.frequency_mhz), lst
        )
        for dipole, arm in instrument.dipole_azimuth_deg.items()
    }
    origin = f"sky {sky_model.name}, antenna {antenna_model.name}"
    return SkyPower(instrument.frequency_mhz, lst, power, origin)
