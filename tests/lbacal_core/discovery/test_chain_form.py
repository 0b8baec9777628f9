"""Sizes where the LNA's noise enters behind the resonance; the data are made by the formulas of this file."""

import numpy as np
import pytest

from lbacal_core.calibration.chain_form import FORM_OF_CHAIN
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.sidereal import sun_position
from lbacal_core.spectra.spectra import Spectra

TAU, EVENTS, ANTENNAS = 0.03, 400, 4


def draw(simulation, share, rng):
    """A station-year under an ionosphere, P = ((P_sky e^-tau G_ant + N) L G_RCU + N_RCU G_RCU) S + N_ADC.

    N is `share` of the strongest channel's P_sky G_ant, so that it is a larger part of the sky away from the resonance.
    """
    one = simulation.instrument
    nu, gain = one.frequency_mhz, one.antenna_gain
    time_unix = 1_388_534_400.0 + np.sort(rng.uniform(0.0, 365.25 * 86_400, EVENTS))
    altitude, _ = sun_position(time_unix, one.latitude_deg, one.longitude_deg)
    tau = TAU * (30.0 / nu) ** 2 * np.sqrt(np.clip(np.sin(altitude), 0.0, None))[:, None]
    power, owners = [], [(antenna, letter) for antenna in range(ANTENNAS) for letter in "XY"]
    common = rng.normal(0.0, 0.02, (EVENTS, 1))
    for antenna, letter in owners:
        sky = simulation.sky_at("CS002", letter, time_unix)
        strongest = (sky.mean(axis=0) * gain).max()
        loss = one.cables[one.cable_of("CS002", antenna, time_unix[0])]
        at_lna = (sky * np.exp(-tau) * gain + share * strongest) * loss
        at_receiver = at_lna * np.exp(common + rng.normal(0.0, 0.03, (EVENTS, 1))) + 5e-4 * strongest
        recorded = 1e3 / strongest * at_receiver * one.receiver_gain + 0.2
        power.append(recorded * rng.gamma(500.0, 1.0 / 500.0, recorded.shape))
    count = len(owners)
    return Spectra(
        frequency_mhz=nu,
        power=np.concatenate(power),
        event_id=np.tile([f"E{k:04d}" for k in range(EVENTS)], count),
        time_unix=np.tile(time_unix, count),
        station=np.full(count * EVENTS, "CS002"),
        antenna=np.repeat([antenna for antenna, _ in owners], EVENTS),
        dipole=np.repeat([letter for _, letter in owners], EVENTS),
        blocks=np.full(count * EVENTS, 100),
    )


@pytest.mark.parametrize(("share", "words"), [(0.0, "in front of"), (0.03, "behind")])
@pytest.mark.long
def test_the_size_of_the_ionosphere_does_not_depend_on_where_noise_enters(simulation, share, words):
    report, _ = investigate(draw(simulation, share, np.random.default_rng(41)), simulation)
    assert report["provenance"]["notes"][FORM_OF_CHAIN].startswith(f"noise enters {words} the antenna's resonance")
    (found,) = [one for one in report["findings"] if one["cause"] == "ionospheric_absorption"]
    assert abs(found["size"]["value"] - TAU) < 2.0 * found["size"]["sigma"]
    assert found["size"]["sigma"] < 0.25 * TAU
