from __future__ import annotations

import numpy as np

from lbacal_twin.faults.receiver import AdcJitter, Compression, FilterShift

FREQUENCY = np.arange(30.0, 81.0)


def test_a_pass_band_that_moves_up_gains_where_it_falls(plant) -> None:
    moved = plant(FilterShift(size=-1e-3, date="2014-06-01"))
    after = moved.time_unix > 1_402_000_000
    assert moved.effect[0, 0, after, 48].min() > 0  # G(nu(1-s)) on the falling edge at 78 MHz


def test_compression_turns_power_down_when_there_is_more_than_usual(plant) -> None:
    effect = plant(Compression(size=0.1))
    total = effect.clean[3, 1].sum(axis=1)
    at_peak = effect.effect[3, 1, :, 28]
    assert np.corrcoef(at_peak, total)[0, 1] < -0.99


def test_jitter_is_white_and_rises_with_the_slope_of_the_signal(plant) -> None:
    jitter = plant(AdcJitter(size=0.01))
    added = (jitter.power - jitter.clean)[0, 0]
    np.testing.assert_allclose(added, added[:, :1] * np.ones(51), rtol=1e-6)
    steepness = jitter.clean[0, 0] @ FREQUENCY**2
    assert np.corrcoef(added[:, 0], steepness)[0, 1] > 0.999
