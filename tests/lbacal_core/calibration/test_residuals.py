import numpy as np
import pytest

from lbacal_core.curves.curves import CONVERGED, CalibrationCurve, Parameter
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation, noise_at_input
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings


@pytest.fixture(scope="module")
def campaign(low_band: Instrument, two_waves: SkyPower) -> Campaign:
    settings = TwinSettings(events_per_year=300, stations=("CS002",), antennas=3)
    return simulate_campaign(settings, low_band, two_waves, np.random.default_rng(3))


def _planted_curve(campaign: Campaign, antenna: int, dipole: str) -> CalibrationCurve:
    truth = campaign.truth.stations[0]
    c = campaign.truth.curve(dipole, "CS002", antenna)
    parameters = {name: Parameter(getattr(truth, name), 1.0) for name in ("n_lna", "n_rcu", "n_adc")}
    frequency = campaign.truth.frequency_mhz
    return CalibrationCurve(
        "CS002", antenna, dipole, CONVERGED, 300, frequency, c, 0.01 * c, None, 1.0, 1.0, parameters
    )  # fmt: skip


def test_the_planted_curve_predicts_the_spectra_within_their_scatter(campaign, low_band, two_waves):
    block = split_into_blocks(campaign.spectra)[0]
    curve = _planted_curve(campaign, 1, "X")
    sky = two_waves.at("X", local_sidereal_time(block.time_unix, low_band.longitude_deg))
    deviation = block.power[1] / Simulation(low_band, two_waves).power(curve, sky) - 1.0
    # Event gain 5 % and radiometer noise 4.4 % in squares; 300 events, so the mean is known to 0.3 %.
    assert abs(deviation.mean()) < 0.01
    assert deviation.std() == pytest.approx((0.05**2 + 0.0442**2) ** 0.5, rel=0.1)


def test_noise_terms_at_the_input_add_up_to_the_predicted_power(campaign, low_band):
    curve = _planted_curve(campaign, 0, "Y")
    assert curve.c is not None
    terms = noise_at_input(curve, low_band)
    assert set(terms) == {"lna", "rcu", "adc"}
    silent = Simulation(low_band).electronics(curve)
    np.testing.assert_allclose(sum(terms.values()) * low_band.antenna_gain / curve.c**2, silent)
    assert terms["adc"] == pytest.approx(curve.parameters["n_adc"].value * curve.c**2 / low_band.antenna_gain)
