from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.chain.intercepts import three_constants
from lbacal_core.discovery.curve_fit import GRID_HOURS, fit_station_year


@pytest.fixture(scope="module")
def simulated(chain, sky):
    """P_sky of both dipoles, shape (dipole, lst, freq), and the slope and the noise of a chain, shape (freq,)."""
    own = np.stack([sky.at(d, GRID_HOURS) for d in "XY"])
    slope = 1e16 * chain.antenna_gain
    noise = 0.3 * slope * own.mean() + 20.0 * chain.receiver_gain / chain.receiver_gain.max() + 10.0
    return own, slope, noise


def test_a_chain_that_the_data_follow_comes_back_without_scatter(chain, simulated):
    own, slope, noise = simulated
    found = fit_station_year(slope * own + noise, own, three_constants(chain.receiver_gain))
    # The scatter of a station-year would move weak channels by percents; its pairs cancel to first order.
    assert found == pytest.approx(np.broadcast_to(slope, found.shape), rel=5e-3)


def test_noise_of_any_level_changes_no_slope(chain, simulated):
    own, slope, noise = simulated
    terms = three_constants(chain.receiver_gain)
    quiet, noisy = (fit_station_year(slope * own + factor * noise, own, terms) for factor in (1.0, 2.0))
    assert noisy == pytest.approx(quiet, rel=1e-2)
