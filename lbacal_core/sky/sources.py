"""What a dipole receives from a direction, and from a point source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_core.antenna.model import AntennaModel, directional_response
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import raise_arm
from lbacal_core.data.constants import IMPEDANCE_OF_FREE_SPACE
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import RESISTANCE_OHM
from lbacal_core.provenance import hash_content
from lbacal_core.sky.antenna_of import antenna_for_ratios
from lbacal_core.sky.model import DATA_EPOCH, PointSource, local_direction, precess
from lbacal_core.sky.table import SkyPower

JANSKY = 1e-26
HERTZ_PER_MHZ = 1e6


def response_towards(
    instrument: Instrument, dipole: str, zenith: Floats, azimuth: Floats, antenna: str | AntennaModel | None = None
) -> Floats:
    """D of one dipole towards directions, shape (..., freq); 0 below the horizon.

    Parameters
    ----------
    zenith, azimuth
        Shape (...), rad, azimuth north through east.
    """
    model = load_antenna(antenna or antenna_for_ratios(instrument))
    from_arm = np.asarray(azimuth) - np.radians(instrument.dipole_azimuth_deg[dipole])
    raised = raise_arm(model, instrument.tilt_deg(dipole))
    response = directional_response(raised, instrument.frequency_mhz, np.asarray(zenith), from_arm, model)
    return np.moveaxis(response, 0, -1)


def point_source_power(flux_jy: Floats, response: Floats) -> Floats:
    """Power of an unpolarised point source in units of P_sky, W m^-2 MHz^-1: Z_0 S D / (2 R_r).

    With S = 2 k_B nu^2 T dOmega / c^2 in eq. total_sky_power_eq.

    Parameters
    ----------
    flux_jy
        Shape (freq,), Jy.
    response
        D towards the source, shape (..., freq).
    """
    return np.asarray(IMPEDANCE_OF_FREE_SPACE / (2 * RESISTANCE_OHM) * flux_jy * JANSKY * HERTZ_PER_MHZ * response)


def source_sky_power(
    instrument: Instrument,
    source: PointSource,
    dipole: str,
    lst_hours: Floats,
    year: float = DATA_EPOCH,
    antenna: str | AntennaModel | None = None,
) -> Floats:
    """Contribution of a source to P_sky of one dipole over a sidereal day, shape (lst, freq)."""
    right_ascension, declination = np.radians([[source.right_ascension_deg], [source.declination_deg]])
    zenith, azimuth = local_direction(lst_hours, *precess(right_ascension, declination, year), instrument.latitude_deg)
    response = response_towards(instrument, dipole, zenith, azimuth, antenna)
    return point_source_power(source.flux_jy(instrument.frequency_mhz, year), response)


def add_sources(
    sky_power: SkyPower,
    instrument: Instrument,
    sources: Sequence[PointSource],
    year: float = DATA_EPOCH,
    antenna: str | AntennaModel | None = None,
) -> SkyPower:
    """P_sky with point sources added; maps that resolve them contain them already (docs/explanation)."""
    if not sources:
        return sky_power
    model = load_antenna(antenna or antenna_for_ratios(instrument))
    power = {
        dipole: values
        + sum(source_sky_power(instrument, one, dipole, sky_power.lst_hours, year, model) for one in sources)
        for dipole, values in sky_power.power.items()
    }
    names = "".join(f" + {source.name} {year:g}" for source in sources)
    inputs = [sky_power.digest(), names, year, instrument.digest(), model.digest()]
    made_for = None if sky_power.made_for is None else sky_power.made_for.with_sky(names)
    stations = {
        name: add_sources(one, instrument.at_station(name), sources, year, model)
        for name, one in sky_power.stations.items()
    }
    added = replace(sky_power, power=power, origin=sky_power.origin + names, made_for=made_for, stations=stations)
    return added.of_inputs(hash_content(inputs))
