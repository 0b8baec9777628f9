"""The package's own P_sky: a sky model seen by an antenna model where an instrument stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from lbacal_core.antenna.model import AntennaModel, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, hash_content
from lbacal_core.sky.antenna_of import antenna_for_ratios, antenna_of
from lbacal_core.sky.model import DATA_EPOCH, SkyModel, precess_multipoles
from lbacal_core.sky.modes import beam_multipoles, combine, sky_power_at
from lbacal_core.sky.names import default_sky, load_sky
from lbacal_core.sky.table import MadeFor, SkyPower

LST_HOURS = np.arange(96) / 4.0
"""The default grid; P_sky has so few Fourier terms that it is exact between these points as well."""


def compute_sky_power(
    instrument: Instrument,
    sky: str | SkyModel | None = None,
    antenna: str | AntennaModel | None = None,
    lst_hours: Floats | None = None,
) -> SkyPower:
    """P_sky(LST, nu) of each dipole for the instrument's place, arms and channels, and for its stations elsewhere.

    Parameters
    ----------
    sky, antenna
        A model, or the name or file of one; those that the instrument names unless given.
    lst_hours
        Shape (lst,), hours, regular over the sidereal day; default 96 from 0.

    Returns
    -------
    Directional sky power, W m^-2 MHz^-1 for R_r = 50 ohm.
    """
    sky = sky or instrument.sky or default_sky(instrument.frequency_mhz)
    sky_model = load_sky(sky) if isinstance(sky, str) else sky
    antenna_model = load_antenna(antenna or antenna_of(instrument))
    lst = LST_HOURS if lst_hours is None else np.asarray(lst_hours, dtype=float)
    frequency_mhz = instrument.frequency_mhz
    temperature = precess_multipoles(sky_model.temperature(frequency_mhz), DATA_EPOCH)
    tilts = {dipole: instrument.tilt_deg(dipole) for dipole in instrument.dipoles}
    beams = {tilt: beam_multipoles(antenna_model, frequency_mhz, sky_model.lmax, tilt) for tilt in set(tilts.values())}
    origin = f"sky {sky_model.name}, antenna {antenna_model.name}"
    models = {"sky": sky_model.digest(), "antenna": antenna_model.digest()}
    versions = {"lbacal": version("lbacal"), "model_version": MODEL_VERSION}

    def table_of(one: Instrument, stations: Mapping[str, SkyPower]) -> SkyPower:
        """P_sky where an instrument stands."""
        power = {
            dipole: sky_power_at(combine(temperature, beams[tilts[dipole]], arm, one.latitude_deg, frequency_mhz), lst)
            for dipole, arm in one.dipole_azimuth_deg.items()
        }
        arms, hashes = dict(one.dipole_azimuth_deg), {"instrument": one.view_digest(), **models}
        inputs = {
            **models,
            "latitude_deg": one.latitude_deg,
            "dipole_azimuth_deg": arms,
            "frequency_mhz": frequency_mhz.tolist(),
            "lst_hours": lst.tolist(),
            "epoch": DATA_EPOCH,
            **({"dipole_tilt_deg": tilts} if any(tilts.values()) else {}),
        }
        made_for = MadeFor(one.name, sky_model.name, antenna_model.name, arms, hashes, versions)
        table = SkyPower(frequency_mhz, lst, power, origin, made_for=made_for, stations=stations)
        return table.of_inputs(hash_content(inputs))

    north = instrument.latitude_deg
    elsewhere = [station for station, site in instrument.sites.items() if site.latitude_deg != north]
    return table_of(instrument, {station: table_of(instrument.at_station(station), {}) for station in elsewhere})


# P_sky with a changed beam.


def vary_sky_power(
    instrument: Instrument,
    *,
    lst_hours: Floats | None = None,
    azimuth_deg: float = 0.0,
    zenith_exponent: float = 0.0,
    zenith_gain_fraction: float = 0.0,
) -> SkyPower:
    """P_sky where the instrument stands as `compute_sky_power`, with the beam varied and its G_ant left as it is.

    A variation of the gain at zenith appears in P_sky, so that P_sky G_ant is the power received; parameters as in
    `VariedAntenna`.
    """
    base = load_antenna(antenna_for_ratios(instrument))
    varied = VariedAntenna(base, azimuth_deg, zenith_exponent=zenith_exponent, zenith_gain=zenith_gain_fraction)
    result = compute_sky_power(replace(instrument, sites={}), None, varied, lst_hours)
    gain = zenith_gain(varied, instrument.frequency_mhz) / zenith_gain(base, instrument.frequency_mhz)
    received = replace(result, power={dipole: values * gain for dipole, values in result.power.items()})
    return received.of_inputs(hash_content([result.digest(), "gain of the base", base.digest()]))
