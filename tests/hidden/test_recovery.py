"""The fit finds what the twin planted, though the two share no model of the signal chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings


def test_almost_without_scatter_the_fit_finds_the_planted_curve_and_noise(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    still = TwinSettings(stations=("CS002",), event_gain_common=0, event_gain_path=0, radiometer=1e-5)
    campaign = simulate_campaign(still, low_band, two_waves, np.random.default_rng(1))
    truth = campaign.truth.stations[0]
    for scope in ("antenna", "station"):
        for curve in fit_calibration(campaign.spectra, Simulation(low_band, two_waves), scope).curves:
            assert curve.status == CONVERGED
            planted = campaign.truth.curve(curve.dipole or "", curve.station, curve.antenna)
            # Noise of 1e-5 for 4.4e-2: errors 4400 times smaller than the 1 % of a real year.
            np.testing.assert_allclose(curve.c, planted, rtol=3e-5)
            for name in ("n_lna", "n_rcu", "n_adc"):
                np.testing.assert_allclose(curve.parameters[name].value, getattr(truth, name), rtol=1e-3)


@pytest.mark.long
def test_errors_claimed_are_errors_made_for_paths_and_stations(low_band: Instrument, two_waves: SkyPower) -> None:
    """Pulls over 25 campaigns; one campaign is one draw, because errors are correlated along frequency and paths."""
    settings = replace(TwinSettings(), stations=("CS002",), antennas=2)
    pulls: dict[str, list[float]] = {"antenna": [], "station": []}
    for seed in range(25):
        campaign = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(1000 + seed))
        for scope, values in pulls.items():
            for curve in fit_calibration(campaign.spectra, Simulation(low_band, two_waves), scope).curves:
                assert curve.c is not None
                assert curve.c_sigma_stat is not None
                planted = campaign.truth.curve(curve.dipole or "", curve.station, curve.antenna)
                values.append(float(((curve.c - planted) / curve.c_sigma_stat)[25]))
    for scope, values in pulls.items():
        # 25 independent campaigns: the standard deviation is known to 14 %, the mean to 0.2; 2.5 times that.
        assert 0.65 < np.std(values) < 1.35, scope
        assert abs(np.mean(values)) < 0.5, scope
