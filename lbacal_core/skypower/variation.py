"""P_sky with a changed beam."""

from __future__ import annotations

from dataclasses import replace

from lbacal_core.antenna.model import AntennaModel, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import hash_content
from lbacal_core.sky.model import SkyModel
from lbacal_core.skypower.antenna_of import antenna_for_ratios
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower


def vary_sky_power(
    instrument: Instrument,
    sky: str | SkyModel | None = None,
    antenna: str | AntennaModel | None = None,
    lst_hours: Floats | None = None,
    *,
    azimuth_deg: float = 0.0,
    tilt_deg: float = 0.0,
    tilt_towards_deg: float = 0.0,
    zenith_exponent: float = 0.0,
    zenith_gain_fraction: float = 0.0,
) -> SkyPower:
    """P_sky where the instrument stands as `compute_sky_power`, with the beam varied and its G_ant left as it is.

    A variation that changes the gain at zenith (`zenith_gain_fraction`, a tilt) appears in P_sky, so that
    P_sky G_ant is the power received; parameters as in `VariedAntenna`.
    """
    antenna = antenna or antenna_for_ratios(instrument)
    base = load_antenna(antenna) if isinstance(antenna, str) else antenna
    varied = VariedAntenna(base, azimuth_deg, tilt_deg, tilt_towards_deg, zenith_exponent, zenith_gain_fraction)
    result = compute_sky_power(replace(instrument, sites={}), sky, varied, lst_hours)
    gain = zenith_gain(varied, instrument.frequency_mhz) / zenith_gain(base, instrument.frequency_mhz)
    received = replace(result, power={dipole: values * gain for dipole, values in result.power.items()})
    return received.of_inputs(hash_content([result.digest(), "gain of the base", base.digest()]))
